"""Where the `deltatwin` program begins: what ends it is heard before anything is read from a file."""

try:
    import atexit

    from service.stopping import all_is_done, end_at_once

    end_at_once()
    atexit.register(all_is_done)  # the first that is registered is the last that runs
except KeyboardInterrupt:  # nothing is begun yet, not even what this line would need
    __import__("os")._exit(130)


def main() -> None:
    """Run a subcommand, see `service.cli.main`."""
    from service.cli.main import main

    main()


if __name__ == "__main__":
    main()

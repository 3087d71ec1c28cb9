"""Where the `deltatwin` program begins: what ends it is heard before anything is read from a file."""

import atexit
import os

try:
    from service.stopping import all_is_done, end_at_once
except KeyboardInterrupt:  # nothing is begun yet
    os._exit(130)


def main() -> None:
    """Run a subcommand, see `service.cli.main`."""
    end_at_once()
    atexit.register(all_is_done)  # the first that is registered is the last that runs
    from service.cli.main import main

    main()


if __name__ == "__main__":
    main()

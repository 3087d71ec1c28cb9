"""Reference pages of the commands, from their own help."""

from __future__ import annotations

import inspect
from typing import Any

import click

from docs.making.markdown import cell, code, table
from service.cli.main import GROUPS, INTERRUPTED, MISSED, OTHERS, app, summaries

_EXAMPLE = "Example: "


def _group() -> Any:
    import typer

    return typer.main.get_command(app)


def groups() -> dict[str, list[str]]:
    """Names of commands by the headings of `deltatwin --help`."""
    known = {name for names in GROUPS.values() for name in names}
    found = {title: [name for name in names if name in summaries()] for title, names in GROUPS.items()}
    found[OTHERS] = [name for name in summaries() if name not in known]
    return {title: names for title, names in found.items() if names}


def page(name: str) -> str:
    """What `deltatwin NAME --help` says."""
    group = _group()
    context = click.Context(group, info_name="deltatwin")
    command = group.get_command(context, name)
    inner = click.Context(command, info_name=name, parent=context)
    paragraphs = [" ".join(part.split()) for part in inspect.cleandoc(command.help or "").split("\n\n")]
    said = [part for part in paragraphs if not part.startswith(_EXAMPLE)]
    examples = [part.removeprefix(_EXAMPLE) for part in paragraphs if part.startswith(_EXAMPLE)]
    text = [f"# deltatwin {name}\n", *(cell(part) + "\n" for part in said)]
    text.append("```console\n" + "\n".join(f"$ {example}" for example in examples) + "\n```\n")
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    if arguments:
        text.append("## Arguments\n")
        text.append(table(["Argument", "Meaning"], (_row(p, inner) for p in arguments)))
    text.append("## Options\n")
    options = [p for p in command.get_params(inner) if p.param_type_name == "option" and not p.hidden]
    text.append(table(["Option", "Meaning"], (_row(p, inner) for p in options)))
    text.append("\nExit codes: see [Exit codes](../exit-codes.md).\n")
    return "\n".join(text)


def _row(parameter: Any, context: click.Context) -> list[str]:
    record = parameter.get_help_record(context)
    left, right = record or (parameter.make_metavar(context), "")
    return [code(left), cell(right)]


def index() -> str:
    """All commands with what each is for."""
    text = ["# Commands\n", "Generated from `deltatwin --help`. Every command takes `--help`; most take `--json`.\n"]
    for title, names in groups().items():
        text.append(f"## {title}\n")
        text.append(table(["Command", "What it does"], ([f"[`{n}`]({n}.md)", cell(summaries()[n])] for n in names)))
    return "\n".join(text)


def exit_codes() -> str:
    """Exit codes of every command."""
    rows = [
        [
            "`0`",
            "The command succeeded. Commands that run until they are ended (`replay`, `estimate`, `monitor`, `watch`, "
            "`top`, `view`, `tap`, `segment`, `simulate --live`) end so by Ctrl-C, SIGTERM or a closed terminal, with "
            "their summary.",
        ],
        ["`1`", "A known error. One line on stderr names file, key or row, and value."],
        ["`2`", "Wrong usage: an unknown option, a missing argument, a value out of its range."],
        [
            f"`{MISSED}`",
            "Everything ran, but a stated bound does not hold (`blindtest`, `ethercat-demo` and the like).",
        ],
        [
            f"`{INTERRUPTED}`",
            "Any other command ended by Ctrl-C, SIGTERM or a closed terminal. Files written so far are complete.",
        ],
    ]
    text = "# Exit codes\n\nResults go to stdout, progress and errors to stderr. All commands have these codes.\n\n"
    return text + table(["Code", "Meaning"], rows)

"""A generated twin on disk: its code, the description that it was made from, and a manifest that ties them."""

from __future__ import annotations

import hashlib
import json
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from schemas.errors import StorageError
from schemas.files import check_apart, make_folder, read_bytes, write_text
from schemas.robot import Robot, load_robot, save_robot
from schemas.toml import validate
from service.codegen.plc import Project
from service.codegen.plcopen import as_xml
from service.codegen.twin import Twin

MANIFEST, DESCRIPTION = "twin.json", "description.toml"
MAX_BYTES = 64 << 10
MAX_CODE_BYTES = 16 << 20


class Manifest(BaseModel):
    """name: of files and functions. period_s: of a cycle. files: of code. sha256: of them, one behind the other.
    single: in single precision. id: what the C code says of itself, hexadecimal."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    schema_: Literal["deltatwin.twin/1"] = Field("deltatwin.twin/1", alias="schema")
    deltatwin: str
    robot: str
    name: str
    period_s: Annotated[float, Field(gt=0)]
    files: Annotated[list[Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*\.(h|c|st|xml)$")]], Field(min_length=1)]
    sha256: str
    single: bool = False
    id: Annotated[str, Field(pattern=r"^[0-9a-f]{0,16}$")] = ""


def of_c(twin: Twin) -> dict[str, str]:
    """Files of code, name -> text."""
    return {f"{twin.name}.h": twin.header, f"{twin.name}.c": twin.source}


def of_st(project: Project) -> dict[str, str]:
    return {f"{project.name}.st": project.text, f"{project.name}.xml": as_xml(project)}


def write_twin(robot: Robot, period: float, made: Twin | Project, folder: Path) -> list[Path]:
    """Write the code of `robot` into `folder`. Returns the files.

    Raises:
        StorageError: one cannot be written, or is what the robot was read from.
    """
    make_folder(folder)
    is_c = isinstance(made, Twin)
    code = of_c(made) if is_c else of_st(made)
    manifest = Manifest(
        schema="deltatwin.twin/1",
        deltatwin=version("deltatwin"),
        robot=robot.name,
        name=made.name,
        period_s=period,
        files=list(code),
        sha256=hashlib.sha256("".join(code.values()).encode()).hexdigest(),
        single=is_c and made.single,
        id=f"{made.id:016x}" if is_c else "",
    )
    texts = code | {MANIFEST: manifest.model_dump_json(by_alias=True, indent=1) + "\n"}
    written = [folder / file for file in (*texts, DESCRIPTION)]
    for path in written:
        check_apart(path, *robot.sources)
    for file, text in texts.items():
        write_text(folder / file, text)
    save_robot(robot, folder / DESCRIPTION)
    return written


def read_twin(folder: Path) -> tuple[Manifest, Robot]:
    """The manifest and the description of what `write_twin` wrote.

    Raises:
        StorageError: it is not there, or the code was changed since. RobotError: the description is wrong.
    """
    path = folder / MANIFEST
    try:
        values = json.loads(read_bytes(path, MAX_BYTES, StorageError))
    except (ValueError, RecursionError) as error:
        raise StorageError(f"{path}: not what `export --to c` or `--to st` wrote: {error}") from None
    manifest = validate(Manifest, values if isinstance(values, dict) else {}, path, StorageError)
    texts = [read_bytes(folder / file, MAX_CODE_BYTES, StorageError) for file in manifest.files]
    if hashlib.sha256(b"".join(texts)).hexdigest() != manifest.sha256:
        raise StorageError(f"{folder}: {' or '.join(manifest.files)} was changed after the export: export it again")
    return manifest, load_robot(folder / DESCRIPTION)

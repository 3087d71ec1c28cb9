"""Models of Delta robots, servo axes and arms, compared with the real machine: identification, payload, gap.

    import deltatwin as dt

    robot = dt.load_robot("robot.toml")
    logs = [dt.read_trace(path, robot) for path in ("fit_a.csv", "fit_b.csv", "fit_c.csv")]
    known = dt.identify(robot, logs)               # known.robot has the identified parameters
    found = dt.diagnose(robot, logs)               # which unmodelled effect causes the gap; found.robot is corrected
    dt.save_robot(found.robot, "corrected.toml")
    dt.payload(found.robot, dt.read_trace("pick.csv", robot)).plot()

The names in `__all__` are stable: they keep their meaning from one minor version to the next, or warn for one version
first. All quantities are in SI units, on the joint side of the gears: s, rad, N m, kg; m and N for linear axes. Joints
are numbered from 0 in arrays and from 1 in texts and frames. Every error is a `DeltatwinError` whose message is one
line.

Nothing large is imported before it is used.
"""

# Nothing is imported here, `__future__` is a file too: a program that Ctrl-C reaches in these lines cannot hear it.
TYPE_CHECKING = False  # that of `typing`
if TYPE_CHECKING:
    from typing import Any

    from deltatwin.functions import (
        Description,
        diagnose,
        evaluate,
        identify,
        load_demo,
        load_robot,
        payload,
        read_trace,
        rollout,
        save_robot,
    )
    from deltatwin.public_trace import Trace
    from deltatwin.results import (
        DiagnosisResult,
        EvaluationResult,
        IdentificationResult,
        JointRolloutResult,
        LoadResult,
        PayloadResult,
        RolloutResult,
    )
    from schemas.errors import DataError, DeltatwinError, PoseError, RobotError, StorageError, TraceError

__all__ = [
    "DataError",
    "DeltatwinError",
    "Description",
    "DiagnosisResult",
    "EvaluationResult",
    "IdentificationResult",
    "JointRolloutResult",
    "LoadResult",
    "PayloadResult",
    "PoseError",
    "RobotError",
    "RolloutResult",
    "StorageError",
    "Trace",
    "TraceError",
    "diagnose",
    "evaluate",
    "identify",
    "load_demo",
    "load_robot",
    "payload",
    "read_trace",
    "rollout",
    "save_robot",
]


def __getattr__(name: str) -> "Any":
    if name == "__version__":
        from importlib.metadata import version

        return version("deltatwin")
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name.endswith("Error"):
        from schemas import errors as module
    else:
        import importlib

        home = "public_trace" if name == "Trace" else "results" if name.endswith("Result") else "functions"
        module = importlib.import_module(f"{__name__}.{home}")
    found = globals()[name] = getattr(module, name)
    return found


def __dir__() -> list[str]:
    return [*__all__, "__version__"]

"""The entry point `extremal`: one small module a command, imported when it is the one that runs."""

import io
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr
from importlib import import_module, metadata
from inspect import signature
from typing import Any

# A command `name` is the function `name(settings: SomeDataclass)` of the module `extremal.scripts.name`, but for MODULES.
COMMANDS = {
    "look": "look at a scene: from rendered frames to curvature with its uncertainty, beside the truth",
    "strip": "the strip of surface that extremal boundaries sweep, continued beyond, and checked in unseen views",
    "reconstruct": "a whole object from contours seen from all around, beside a visual hull and stereo",
    "calibrate": "calibrate camera, hand-eye transform and arm by a board, simulated or from your own photographs",
    "accuracy": "measure accuracy over random vases, lights and noise; makes the tables of docs/accuracy.md",
    "navigate": "one episode around a curved obstacle, with a film and its scores",
    "grasp": "one episode of lifting a vase by the side that was not seen, with a film and its scores",
    "evaluate": "how well a policy does in a task: success over test episodes, with confidence intervals",
    "sweep": "many trials over grids and random draws of any setting; goes on after whatever has killed it",
    "report": "plots of a sweep with confidence intervals",
    "sensitivity": "show what errors of edges and egomotion do to R: figures 3.11 and 3.12 of the book",
    "doctor": "whether offscreen rendering works here, how exactly and how fast; if not, what to install",
}
MODULES = {"report": "sweep_report"}  # the module `report` is what all reports are made of
USAGE_ERROR = 2
INTERRUPTED = 130


def main() -> None:
    """Run the command line; bad input ends with one line on stderr and exit status 2."""
    try:
        sys.exit(run(sys.argv[1:]))
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    except Exception as error:
        from extremal.estimator.errors import ExtremalError  # not above: its package takes a second to import

        if not isinstance(error, ExtremalError):
            raise
        _complain(str(error))
        sys.exit(USAGE_ERROR)


def run(arguments: Sequence[str]) -> int:
    """Run one command and give the exit status; raises ExtremalError on bad input."""
    name, *rest = arguments or ["--help"]
    if name in ("-h", "--help"):
        print(_help())
        return 0 if arguments else USAGE_ERROR
    if name == "--version":
        print(f"extremal {metadata.version('extremal')}")
        return 0
    if name not in COMMANDS:
        _complain(f"unknown command {name!r}; accepted: {', '.join(COMMANDS)}, --help, --version")
        return USAGE_ERROR
    _import_mujoco()
    command = getattr(import_module(f"extremal.scripts.{MODULES.get(name, name)}"), name)
    command(_parse(name, command, rest))
    return 0


def _help() -> str:
    commands = "\n".join(f"  {name:12}{summary}" for name, summary in COMMANDS.items())
    return (
        f"usage: extremal COMMAND [options]\n\n{metadata.metadata('extremal')['Summary']}\n\ncommands:\n{commands}\n\n"
        "options:\n  --help    this; `extremal COMMAND --help` explains a command's options\n"
        "  --version the version"
    )


def _import_mujoco() -> None:
    """Import MuJoCo without MUJOCO_GL: it can't be imported where that names a missing library.

    The first renderer reads the variable and says what to install.
    """
    wanted = os.environ.pop("MUJOCO_GL", None)
    try:
        import_module("mujoco")
    finally:
        if wanted is not None:
            os.environ["MUJOCO_GL"] = wanted


def _parse(name: str, command: Callable[[Any], None], arguments: Sequence[str]) -> Any:
    import tyro

    settings = signature(command, eval_str=True).parameters["settings"].annotation
    complaint = io.StringIO()
    try:
        with redirect_stderr(complaint):
            return tyro.cli(settings, prog=f"extremal {name}", args=arguments)
    except SystemExit as end:
        if end.code:
            _complain(f"{_one_line(complaint.getvalue())} (see extremal {name} --help)")
        raise


def _one_line(box: str) -> str:
    """The message in tyro's box: its first paragraph, without title, frame and the parser's own trials."""
    lines = [line.strip("│ ") for line in box.splitlines() if not line.startswith(("╭", "╰"))]
    rule = next(
        (i for i, line in enumerate(lines) if line.startswith("─") or line == "Got errors:"), len(lines)
    )
    return " ".join(line for line in lines[:rule] if line) or " ".join(box.split())


def _complain(message: str) -> None:
    print(f"extremal: error: {' '.join(message.split())}", file=sys.stderr)


if __name__ == "__main__":
    main()

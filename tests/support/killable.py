"""Inputs given to a function in a child process that may hang, die or eat memory without harm to the caller."""

import importlib
import json
import os
import resource
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, Self

SECONDS, BYTES = 30.0, 4 * 10**9  # that one input may take
START = 60.0  # [s] that a child may take to import what it needs
SUPPORT = Path(__file__).parent

Verdict = Literal["accepted", "refused", "nonsense", "escaped", "hung", "died"]


@dataclass(frozen=True)
class Outcome:
    """What became of an input.

    Attributes:
        case: as it was given.
        verdict: accepted; refused with an error that extremal raises on purpose; nonsense: accepted, but what came out is
            wrong; escaped: any other exception; hung: longer than SECONDS; died: the child is no more.
        message: of the error.
        seconds: what it took.
    """

    case: str
    verdict: Verdict
    message: str = ""
    seconds: float = 0.0


def outcomes(target: str, cases: Sequence[str], seconds: float = SECONDS) -> list[Outcome]:
    """What becomes of each of `cases` in the function "module:name", which takes one text.

    It returns for good, or raises: AssertionError where what came out is nonsense. A child takes case after case; where it
    hangs or dies, it is killed, and the next one goes on.
    """
    found: list[Outcome] = []
    while len(found) < len(cases):
        with _Child(target) as child:
            for case in cases[len(found) :]:
                start = time.perf_counter()
                outcome = child.answer(case, seconds)
                found.append(replace(outcome, seconds=time.perf_counter() - start))
                if outcome.verdict in ("hung", "died"):
                    break
    return found


class _Child:
    def __init__(self, target: str) -> None:
        command = [sys.executable, str(Path(__file__)), target]
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "LP_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
        )
        self._selector = selectors.DefaultSelector()
        assert self._process.stdout
        self._selector.register(self._process.stdout, selectors.EVENT_READ)

    def __enter__(self) -> Self:
        if self._line(START) != "ready":
            self.__exit__()
            raise RuntimeError("a child did not start")
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        self._selector.close()
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe
            with suppress(BrokenPipeError):  # what a dead child was not able to read
                pipe.close()

    def answer(self, case: str, seconds: float) -> Outcome:
        assert self._process.stdin
        try:
            self._process.stdin.write(json.dumps(case).encode() + b"\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            return Outcome(case, "died")
        line = self._line(seconds)
        if line is None:
            return Outcome(case, "hung")
        if not line:
            return Outcome(case, "died", f"exit code {self._process.wait()}")
        verdict, message = json.loads(line)
        return Outcome(case, verdict, message)

    def _line(self, seconds: float) -> str | None:
        """The next line; empty where the child is no more, None where it takes too long."""
        assert self._process.stdout
        if not self._selector.select(seconds):
            return None
        return self._process.stdout.readline().decode().strip()


def misbehave(case: str) -> None:
    """For tests of the harness itself."""
    if case == "sleep":
        time.sleep(1000)
    elif case == "die":
        os.kill(os.getpid(), signal.SIGSEGV)
    elif case == "eat":
        bytearray(10**11)
    assert case != "nonsense"
    if case == "refuse":
        from extremal.estimator.errors import InvalidInput

        raise InvalidInput("accepted: anything else")


def _verdict(target: str, case: str) -> tuple[Verdict, str]:
    from extremal.estimator.errors import ExtremalError

    module, name = target.split(":")
    try:
        getattr(importlib.import_module(module), name)(case)
    except ExtremalError as error:
        return ("refused" if "\n" not in str(error) else "escaped"), str(error)
    except AssertionError as error:
        return "nonsense", f"{error!r:.500}"
    except BaseException as error:  # noqa: BLE001  whatever it is, it is the answer
        return "escaped", f"{error!r:.500}"
    return "accepted", ""


def _serve(target: str) -> None:
    """In the child: a line in, a line out."""
    resource.setrlimit(resource.RLIMIT_AS, (BYTES, BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    sys.path.insert(0, str(SUPPORT))
    for module in (target.split(":")[0], "extremal.estimator.errors"):
        importlib.import_module(module)
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no answer
    print("ready", file=answers, flush=True)
    for line in sys.stdin:
        print(json.dumps(_verdict(target, json.loads(line))), file=answers, flush=True)


if __name__ == "__main__":
    _serve(sys.argv[1])

"""Environments in worker processes that may die: their loss is reported, and the next reset goes on with new workers."""

import multiprocessing
from functools import partial
from typing import Any

import gymnasium as gym
from gymnasium.vector import AsyncVectorEnv, VectorWrapper

from extremal.estimator.errors import ExtremalError, InvalidInput

SECONDS = 60.0  # that a step or reset may take
LONGEST_KILL = 5.0  # [s] until a process that was killed must be gone


class WorkerLost(ExtremalError, RuntimeError):
    """A worker died or did not answer in time. The environments are new ones: reset them."""


class LastingVectorEnv(VectorWrapper):
    """`AsyncVectorEnv` of spawned processes that is rebuilt when one of them is lost.

    A killed worker is noticed at once, one that was stopped or hangs after `seconds`. All workers are then killed and made
    anew, since the others' episodes can't be told apart from the lost one's by a caller who steps them together; WorkerLost
    says which worker was lost and how. Rollouts go on after `reset`.
    """

    def __init__(self, name: str, num_envs: int, seconds: float = SECONDS, **arguments: Any) -> None:
        """
        Args:
            name: of a registered environment. num_envs: number of workers, one environment each.
            seconds: that a step or reset may take, from 0.1. arguments: of the environment.

        Raises InvalidInput for numbers that are none of these.
        """
        if isinstance(num_envs, bool) or not isinstance(num_envs, int) or not 1 <= num_envs <= 1024:
            raise InvalidInput(f"num_envs is {num_envs!r}; accepted: a whole number from 1 to 1024")
        if not 0.1 <= seconds < float("inf"):
            raise InvalidInput(f"seconds is {seconds!r}; accepted: a finite number from 0.1")
        self._makers = [partial(gym.make, name, **arguments)] * num_envs
        self._seconds = seconds
        super().__init__(self._made())

    def _made(self) -> AsyncVectorEnv:
        # a fork of a process that renders would wait for ever; memory is not shared: observations are the caller's own
        return AsyncVectorEnv(self._makers, shared_memory=False, context="spawn")

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """As `AsyncVectorEnv.reset`; raises WorkerLost."""
        return self._asked("reset", seed, options)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """As `AsyncVectorEnv.step`; raises WorkerLost, or the error of an environment, after which all are new ones, too."""
        return self._asked("step", actions)

    def close(self, **_: Any) -> None:
        """End the workers, whatever state they are in."""
        if not self._workers.closed:
            self._kill()

    @property
    def _workers(self) -> AsyncVectorEnv:
        assert isinstance(self.env, AsyncVectorEnv)
        return self.env

    def _asked(self, what: str, *arguments: Any) -> Any:
        try:
            getattr(self._workers, f"{what}_async")(*arguments)
            return getattr(self._workers, f"{what}_wait")(timeout=self._seconds)
        except (EOFError, OSError, multiprocessing.TimeoutError) as error:
            lost = self._lost(isinstance(error, multiprocessing.TimeoutError))
        except Exception:  # an environment's own, whose worker has ended
            self._rebuild()
            raise
        self._rebuild()
        raise WorkerLost(f"{lost}: all {self.num_envs} environments were made anew; accepted next: reset()")

    def _rebuild(self) -> None:
        self._kill()
        self.env = self._made()

    def _lost(self, late: bool) -> str:
        """Which workers are lost, and how."""
        workers = self._workers
        for process in workers.processes:
            process.join(0.05 if not late else 0)  # a process's exit may come after its pipe's end
        dead = [(i, p.exitcode) for i, p in enumerate(workers.processes) if p.exitcode is not None]
        if dead:
            return ", ".join(
                f"worker {i} {f'was killed by signal {-code}' if code < 0 else f'ended with status {code}'}"
                for i, code in dead
            )
        silent = [str(i) for i, pipe in enumerate(workers.parent_pipes) if not pipe.poll(0)]
        return f"worker {', '.join(silent)} did not answer within {self._seconds:g} s"

    def _kill(self) -> None:
        """Kill all workers (SIGKILL: those that were stopped, too) and wait until they are gone."""
        workers = self._workers
        for process in workers.processes:
            process.kill()
        for process, pipe in zip(workers.processes, workers.parent_pipes, strict=True):
            process.join(LONGEST_KILL)
            if pipe is not None:  # of a worker that gymnasium has ended
                pipe.close()
        workers.error_queue.close()
        workers.closed = True

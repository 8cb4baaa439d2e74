"""Compiles the loops of the tasks before several processes of tests would, each for itself: a short episode of every environment."""

import gymnasium as gym
import numpy as np

import extremal.tasks  # noqa: F401  registers the environments

LOOKS = 40  # steps after which everything has been told once, references too


def main() -> None:
    for name in ("Inspect", "Navigate", "Grasp"):
        env = gym.make(f"extremal/{name}-v0")
        env.reset(seed=0)
        assert env.action_space.shape is not None
        action = np.zeros(env.action_space.shape, np.float32)
        action[1] = 0.5
        action[6:] = -1.0
        for _ in range(LOOKS):
            if env.step(action)[2]:
                break
        env.close()


if __name__ == "__main__":
    main()

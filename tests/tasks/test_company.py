"""Contours beside each other, as tracks tell of them, against the same rule for contours of images."""

from types import SimpleNamespace

import numpy as np

from extremal.estimator import Camera
from extremal.estimator.camera import Array
from extremal.estimator.sequential import COMPANY
from extremal.estimator.sequential import in_company as beside_contours
from extremal.tasks.company import in_company

CAMERA = Camera()
STEP = 20.0  # [px] between tracks


def lines(rng: np.random.Generator) -> tuple[Array, Array, np.ndarray]:
    """Pixels (n, 2) and unit normals (n, 2) of tracks on four lines, some of them parallel, and the line (n,) of each."""
    turn = rng.uniform(0, np.pi)
    pixels, normals, line = [], [], []
    for k in range(4):
        angle = turn + rng.choice([0.0, 0.05, 0.3, 1.0])
        along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        start = [320.0, 240.0] + rng.uniform(-4 * COMPANY, 4 * COMPANY) * across - 60 * along
        pixels.append(start + STEP * np.arange(7)[:, None] * along)
        normals.append(np.tile(across, (7, 1)))
        line.append(np.full(7, k))
    return np.concatenate(pixels), np.concatenate(normals), np.concatenate(line)


def tangent_planes(pixels: Array, normals: Array) -> Array:
    """Normals (n, 3) of the planes through the optical centre that hold lines of the image."""
    along = np.stack([normals[:, 1], -normals[:, 0]], axis=1)
    plane = np.cross(CAMERA.rays(pixels - along), CAMERA.rays(pixels + along))
    return plane / np.linalg.norm(plane, axis=1, keepdims=True)


def test_as_in_images() -> None:
    """Away from the ends of lines; images have an edgel every pixel. Where lines cross, which edgel is nearest may differ."""
    rng, alike, both = np.random.default_rng(0), 0, np.zeros(2, int)
    for _ in range(60):
        pixels, normals, line = lines(rng)
        planes, there = tangent_planes(pixels, normals), np.ones(len(line), bool)
        found = in_company(pixels, planes, np.eye(4), (CAMERA.fx, CAMERA.fy), line, there)
        dense = SimpleNamespace(
            positions=np.concatenate([np.linspace(pixels[7 * k], pixels[7 * k + 6], 121) for k in range(4)]),
            normals=np.repeat(normals[::7], 121, axis=0),
            contour=np.repeat(np.arange(4), 121),
        )
        middle = np.arange(len(line)) % 7 % 6 != 0
        expected = np.zeros(len(line), bool)
        for k in range(4):  # a track is on its own contour, whichever is nearest
            rows = np.flatnonzero(line == k)
            expected[rows] = beside_contours(dense, pixels[rows])  # type: ignore[arg-type]
        alike += np.sum((found == expected)[middle])
        both += np.bincount(expected[middle].astype(int), minlength=2)
    assert both.min() > 100
    assert alike > 0.97 * both.sum()


def test_what_is_not_there_is_no_company() -> None:
    x = np.tile(100 + STEP * np.arange(6), 2)
    pixels = np.stack([x, np.repeat([200.0, 203.0], 6)], axis=1)
    normals, line = np.tile([0.0, 1.0], (12, 1)), np.repeat([0, 1], 6)
    planes = tangent_planes(pixels, normals)

    def beside(there: np.ndarray) -> np.ndarray:
        return in_company(pixels, planes, np.eye(4), (CAMERA.fx, CAMERA.fy), line, there)

    assert beside(np.ones(12, bool)).all()
    assert not beside(line == 0).any()
    assert not in_company(
        pixels, planes, np.eye(4), (CAMERA.fx, CAMERA.fy), 0 * line, np.ones(12, bool)
    ).any()
    far = pixels + [0.0, COMPANY] * (line == 1)[:, None]
    assert not in_company(far, planes, np.eye(4), (CAMERA.fx, CAMERA.fy), line, np.ones(12, bool)).any()

"""Coarser meshes for frames that are sampled coarsely: how far they leave the surface, and what they save."""

import numpy as np
import pytest

from extremal.estimator import InvalidInput
from extremal.scenes import Surface, load_scene
from extremal.scenes.grids import MEASURED, QUICK, Facets

FOCAL, NEAR, NOISE = 800.0, 0.14, 0.033  # [px], [m], [px] of a limb's edgels in such frames
SAMPLED = 2000  # triangles of a piece, about


def away(surface: Surface, facets: Facets) -> tuple[int, np.ndarray]:
    """Vertices, and distances [m] of the middles of triangles on curved sides from the surface, negative inside."""
    pieces = [p for p in surface._pieces(facets) if np.ptp(p.normals, axis=0).max() > 0.1]
    chosen = [p.faces[:: max(len(p.faces) // SAMPLED, 1)] for p in pieces]
    middles = np.concatenate([p.vertices[f].mean(axis=1) for p, f in zip(pieces, chosen, strict=True)])
    return sum(len(p.vertices) for p in pieces), surface.signed_distance(surface._world(middles))


@pytest.mark.parametrize("name", ["vase-and-box", "ellipsoid", "sphere"])
def test_quick_facets_stay_below_the_noise(name: str) -> None:
    """Facets lie inside by a bow's height: its spread, not its mean, is what a radius feels."""
    surface = next(s for s in load_scene(name).objects if s.name not in ("table", "box"))
    many, fine = away(surface, MEASURED)
    few, quick = away(surface, QUICK)
    assert few < 0.4 * many
    assert np.abs(quick).max() < 1e-5 and np.abs(fine).max() < np.abs(quick).max()
    assert np.std(quick) * FOCAL / NEAR < NOISE / 3


def test_nothing_else_is_accepted() -> None:
    for arguments in ({"columns": 3}, {"rows": 1.5}, {"chord": 0.0}, {"around": float("nan")}):
        with pytest.raises(InvalidInput, match=f"facets' {next(iter(arguments))} is"):
            Facets(**arguments)  # pyright: ignore[reportArgumentType]

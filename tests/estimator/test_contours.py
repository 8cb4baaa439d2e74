"""Contours in synthetic images with known edges: bias, coverage of sigma, corners, and images without any."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from extremal.estimator import Camera, Contours, find_contours
from extremal.estimator.camera import Array
from extremal.estimator.sequential import in_company

BLUR, NOISE, FINE = 0.7, 2.0, 8
WIDTH, HEIGHT = 200, 160
CAMERA = Camera(width=WIDTH, height=HEIGHT, blur=BLUR)
MARGIN = 4  # [px] beyond the image, so that the blur sees no border


def image_of(
    distance: Callable[[Array, Array], Array],
    inside: float,
    outside: float,
    rng: np.random.Generator,
    noise: float = NOISE,
) -> np.ndarray:
    """8-bit image of the region where a signed distance (x, y) [px] is negative: supersampled, blurred, with noise."""
    y, x = ((np.arange((n + 2 * MARGIN) * FINE) + 0.5) / FINE - 0.5 - MARGIN for n in (HEIGHT, WIDTH))
    cover = np.clip(0.5 - distance(x[None, :], y[:, None]) * FINE, 0, 1)
    fine = gaussian_filter(outside + (inside - outside) * cover, BLUR * FINE)
    grey = fine.reshape(HEIGHT + 2 * MARGIN, FINE, WIDTH + 2 * MARGIN, FINE).mean(axis=(1, 3))
    grey = grey[MARGIN:-MARGIN, MARGIN:-MARGIN] + noise * rng.normal(size=(HEIGHT, WIDTH))
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def disc(centre: Array, radius: float) -> Callable[[Array, Array], Array]:
    return lambda x, y: np.hypot(x - centre[0], y - centre[1]) - radius


def rectangle(centre: Array, half: Array, angle: float) -> Callable[[Array, Array], Array]:
    c, s = np.cos(angle), np.sin(angle)

    def distance(x: Array, y: Array) -> Array:
        u, v = c * (x - centre[0]) + s * (y - centre[1]), -s * (x - centre[0]) + c * (y - centre[1])
        return np.maximum(np.abs(u) - half[0], np.abs(v) - half[1])

    return distance


def discs(inside: float, outside: float, count: int) -> tuple[list[Contours], Array, Array]:
    """Contours of discs at random places; outward error [px] of all edgels and their sigma."""
    rng = np.random.default_rng(int(inside))
    found, error, sigma = [], [], []
    for _ in range(count):
        centre, radius = rng.uniform([95, 75], [105, 85]), rng.uniform(35, 60)
        contours = find_contours(image_of(disc(centre, radius), inside, outside, rng), CAMERA)
        error.append(np.linalg.norm(contours.positions - centre, axis=1) - radius)
        sigma.append(contours.sigma)
        found.append(contours)
        assert len(error[-1]) > 0.8 * 2 * np.pi * radius / 5  # an edgel every 5 px
    return found, np.concatenate(error), np.concatenate(sigma)


@pytest.mark.parametrize(("inside", "outside"), [(60.0, 180.0), (200.0, 90.0), (100.0, 140.0)])
def test_discs(inside: float, outside: float) -> None:
    found, error, sigma = discs(inside, outside, 12)
    # neighbouring edgels share a knot interval of their spline: about one in four is independent
    independent = len(error) / 4
    assert abs(error.mean()) < 0.01 + 5 * error.std() / np.sqrt(independent)
    if abs(inside - outside) > 100:
        assert abs(error.mean()) < 0.01
    coverage = np.mean(np.abs(error) < 1.96 * sigma)
    assert coverage > 0.95 - 5 * np.sqrt(0.05 * 0.95 / independent)
    assert np.sqrt(np.mean((error / sigma) ** 2)) > 0.4  # nor is sigma far too large
    assert np.abs(error).max() < 0.5
    for contours in found:
        bright = np.sign(inside - outside)
        outward = contours.positions - contours.positions.mean(axis=0)
        assert np.all(
            np.sum(contours.normals * outward, axis=1) * bright < 0
        )  # normals point to the bright side
        assert np.all(contours.contrast > 0)
        assert np.median(contours.contrast) == pytest.approx(abs(inside - outside), rel=0.1)
        assert contours.noise == pytest.approx(NOISE, rel=0.2)
        curvature = np.median(contours.curvature)
        assert 1 / 70 < bright * curvature < 1 / 30


def test_an_open_line_is_one_contour() -> None:
    """Pixels of a line that goes down like stairs are traced there and back: by turns one side of the stairs, then the other."""
    rng = np.random.default_rng(4)
    for _ in range(8):
        radius, centre = rng.uniform(60, 110), np.array([rng.uniform(70, 130), HEIGHT])
        contours = find_contours(image_of(disc(centre, radius), 180.0, 60.0, rng), CAMERA)
        assert abs(np.linalg.norm(contours.positions - centre, axis=1) - radius).max() < 0.5
        apart = np.linalg.norm(contours.positions[:, None] - contours.positions, axis=2)
        other = contours.contour[:, None] != contours.contour
        assert np.min(apart, where=other, initial=np.inf) > 4


@pytest.mark.parametrize("angle", [0.0, 0.2, 0.7, 1.3])
def test_corners_split_contours(angle: float) -> None:
    rng = np.random.default_rng(7)
    centre, half = np.array([99.7, 80.2]), np.array([45.3, 30.1])
    contours = find_contours(image_of(rectangle(centre, half, angle), 60.0, 180.0, rng), CAMERA)
    axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    own = (contours.positions - centre) @ axes.T
    beyond = np.abs(own) - half
    axis = np.argmax(beyond, axis=1)  # which pair of sides
    side = 2 * axis + (own[np.arange(len(own)), axis] > 0)
    off, to_corner = beyond.max(axis=1), -beyond.min(axis=1)
    assert set(side) == {0, 1, 2, 3}
    for k in np.unique(contours.contour):
        mine = contours.contour == k
        assert len(set(side[mine])) == 1, "a contour goes round a corner"
        assert np.all(contours.normals[mine] @ contours.normals[mine][0] > 0.98)
    clear = to_corner > 6
    assert clear.sum() > 0.8 * (4 * half.sum() - 8 * 6) / 5
    assert np.abs(off[clear]).max() < 0.3
    sides = np.array([off[clear & (side == k)].mean() for k in range(4)])
    # of 8 to 16 edgels a side
    independent = np.array([np.sum(clear & (side == k)) for k in range(4)]) / 4
    assert np.all(np.abs(sides) < 0.01 + 4 * off[clear].std() / np.sqrt(independent))
    inside = np.abs(off[clear]) < 1.96 * contours.sigma[clear]
    assert inside.mean() > 0.95 - 5 * np.sqrt(0.05 * 0.95 / independent.sum())


@pytest.mark.parametrize(("width", "expected"), [(5.0, True), (12.0, False)])
def test_two_edges_beside_each_other_are_in_company(width: float, expected: bool) -> None:
    """Of a bar: its long sides, where the ends are far; at its ends, and around a disc, no edge runs beside another."""
    rng = np.random.default_rng(5)
    centre, angle = np.array([100.0, 80.0]), 0.3
    contours = find_contours(
        image_of(rectangle(centre, np.array([60.0, width / 2]), angle), 60.0, 180.0, rng), CAMERA
    )
    along = (contours.positions - centre) @ np.array([np.cos(angle), np.sin(angle)])
    sides = np.abs(along) < 50
    assert np.sum(sides) > 30
    np.testing.assert_array_equal(in_company(contours, contours.positions[sides]), expected)
    alone = find_contours(image_of(disc(centre, 50.0), 60.0, 180.0, rng), CAMERA)
    assert not in_company(alone, alone.positions).any()


def test_straight_edges_are_unbiased() -> None:
    rng = np.random.default_rng(8)
    errors = []
    for _ in range(12):
        angle, centre, half = rng.uniform(0, 1.5), rng.uniform([98, 78], [102, 82]), rng.uniform(35, 50, 2)
        contours = find_contours(image_of(rectangle(centre, half, angle), 70.0, 170.0, rng), CAMERA)
        axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        beyond = np.abs((contours.positions - centre) @ axes.T) - half
        errors.append(beyond.max(axis=1)[beyond.min(axis=1) < -8])
    error = np.concatenate(errors)
    assert len(error) > 400
    assert abs(error.mean()) < 0.01


def test_the_sigma_of_noisier_images_is_larger() -> None:
    medians = []
    for noise in (1.0, 3.0, 8.0):
        rng = np.random.default_rng(9)
        contours = find_contours(image_of(disc(np.array([100.0, 80]), 50), 60, 180, rng, noise), CAMERA)
        medians.append(np.median(contours.edgel_sigma))
    assert medians[0] < medians[1] < medians[2]


def test_sigma_between_edgels() -> None:
    rng = np.random.default_rng(10)
    contours = find_contours(image_of(disc(np.array([100.0, 80]), 50), 60, 180, rng), CAMERA)
    np.testing.assert_allclose(contours.sigma_at(contours.u), contours.sigma)
    position = contours.splines.curve(contours.u)
    np.testing.assert_allclose(position, contours.positions)


@pytest.mark.parametrize("level", [0, 128, 255])
def test_blank_images_have_no_contours(level: int) -> None:
    contours = find_contours(np.full((HEIGHT, WIDTH), level, np.uint8), CAMERA)
    assert len(contours.u) == len(contours.positions) == len(contours.sigma) == 0


@pytest.mark.parametrize("noise", [0.5, 2.0, 10.0, 40.0])
def test_noise_has_next_to_no_contours(noise: float) -> None:
    rng = np.random.default_rng(11)
    for _ in range(5):
        image = np.clip(np.rint(128 + noise * rng.normal(size=(480, 640))), 0, 255).astype(np.uint8)
        assert len(find_contours(image, Camera(blur=BLUR)).u) <= 5  # of 300 000 pixels


def test_salt_and_pepper_and_extremes_are_no_error() -> None:
    rng = np.random.default_rng(12)
    for image in (rng.integers(0, 2, (HEIGHT, WIDTH)) * 255, rng.integers(0, 256, (HEIGHT, WIDTH))):
        contours = find_contours(image.astype(np.uint8), CAMERA)
        assert np.all(np.isfinite(contours.positions)) and np.all(np.isfinite(contours.sigma))


@pytest.mark.parametrize("size", [(8, 8), (8, 200), (9, 11), (16, 16), (200, 8), (24, 20)])
def test_tiny_images(size: tuple[int, int]) -> None:
    width, height = size
    camera = Camera(width=width, height=height)
    rng = np.random.default_rng(13)
    step = np.where(np.arange(width) < width // 2, 50, 200) * np.ones((height, 1))
    square = np.full((height, width), 60.0)
    square[2:-2, 2:-2] = 190
    for exact in (np.full((height, width), 99.0), step, step.T if width == height else step, square):
        for noise in (0.0, 2.0):
            image = np.clip(np.rint(exact + noise * rng.normal(size=exact.shape)), 0, 255).astype(np.uint8)
            contours = find_contours(image, camera)
            assert np.all(np.isfinite(contours.positions))
            assert len(contours.u) <= 4 * (width + height)


def test_grey_rgb_is_as_grey() -> None:
    rng = np.random.default_rng(14)
    image = image_of(disc(np.array([100.0, 80]), 50), 60, 180, rng)
    grey, rgb = find_contours(image, CAMERA), find_contours(np.stack([image] * 3, axis=2), CAMERA)
    np.testing.assert_allclose(rgb.positions, grey.positions, atol=1e-4)
    np.testing.assert_array_equal(rgb.contour, grey.contour)


def test_coloured_edges_are_found() -> None:
    rng = np.random.default_rng(15)
    one = image_of(disc(np.array([100.0, 80]), 50), 30, 230, rng)
    rgb = np.stack([one, np.full_like(one, 90), np.full_like(one, 120)], axis=2)
    contours = find_contours(rgb, CAMERA)
    assert len(contours.u) > 50
    assert abs(np.mean(np.linalg.norm(contours.positions - [100.0, 80.0], axis=1) - 50)) < 0.02

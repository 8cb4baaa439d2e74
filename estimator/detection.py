"""Automatic detection of image contours: smooth chains of edge pixels, broken at junctions and corners."""

from dataclasses import dataclass

import cv2
import numpy as np

from extremal.estimator.camera import Array

SMOOTHING = 1.0  # [px] Gaussian before differentiation
GAIN = 8.0  # Sobel response to a slope of one grey level per pixel
CORNER = np.deg2rad(20.0)  # turn over 2 * CORNER_REACH px at which a chain is broken
CORNER_REACH = 5
SHORTEST = 12  # [px]


@dataclass(frozen=True, eq=False)
class Chains:
    """Edge pixels in order: positions (n, 2) [px] to about 0.1 px, and the chain (n,) of each, non-decreasing.

    Each chain is directed so that the brighter side lies to its left as seen in the image (x right, y down). `edges`
    (height, width) is the gradient at all edge pixels, those of no chain included, and 0 elsewhere.
    """

    positions: Array
    chain: np.ndarray
    edges: np.ndarray


def noise_level(grey: Array) -> float:
    """Standard deviation [grey levels] of the noise of a pixel, robust against edges (Immerkaer 1996)."""
    rows = grey[:-2:4] - 2 * grey[1:-1:4] + grey[2::4]  # a pixel of twelve tells enough
    response = np.abs(rows[:, :-2:3] - 2 * rows[:, 1:-1:3] + rows[:, 2::3])
    return max(float(np.median(response)) / 0.6745 / 6.0, 12**-0.5)


def detect_chains(grey: np.ndarray, noise: float, ignored: np.ndarray | None = None) -> Chains:
    """Chains of edge pixels of a grey image (height, width), float32, whose contrast stands clear of `noise`.

    No chain enters pixels that are `ignored` (height, width); their edges are still seen by those beside them.
    """
    smooth = cv2.GaussianBlur(grey, (0, 0), SMOOTHING)
    dx, dy = cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    gradient_noise = GAIN * noise * 0.2  # of the Sobel response after smoothing
    scale = 16.0  # Canny wants 16-bit integers: keep fractions, of responses up to 4 * 255
    low, high = 3.0 * gradient_noise + 1.0, 5.5 * gradient_noise + 2.0
    edges = cv2.Canny(
        (dx * scale).astype(np.int16),
        (dy * scale).astype(np.int16),
        low * scale,
        high * scale,
        L2gradient=True,
    )
    y, x = np.divmod(np.flatnonzero(edges.ravel() > 0), edges.shape[1])
    gradient = np.zeros_like(grey)
    gradient[y, x] = np.hypot(dx[y, x], dy[y, x])
    free = edges if ignored is None else np.where(ignored, 0, edges).astype(np.uint8)
    pixels, chain = _link(_simple(free))
    positions = _subpixel(pixels, dx, dy)
    positions, chain = _split_at_corners(positions, chain)
    return _directed(positions, chain, dx, dy, gradient)


_RING = ((-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1))  # (y, x) of bits 0 to 7
_CROSSINGS = np.array(
    [sum((c >> i & 1) == 0 and (c >> ((i + 1) % 8) & 1) == 1 for i in range(8)) for c in range(256)], np.uint8
)


def _spare(side: int) -> np.ndarray:
    """In which neighbourhoods (256,) a pixel is the corner of a stair, between the one above it and one at its `side` (a bit), and
    all others hang together without it."""
    spare = np.zeros(256, bool)
    for code in range(256):
        has = [bool(code >> i & 1) for i in range(8)]
        # pixels above and beside touch each other whether the one between them is there or not
        joined = [has[i] or (i % 2 == 0 and has[i - 1] and has[(i + 1) % 8]) for i in range(8)]
        spare[code] = has[1] and has[side] and _CROSSINGS[sum(1 << i for i in range(8) if joined[i])] == 1
    return spare


# one after the other: corners of stairs that go down, or up, and then where three or more branches meet
_CUTS = (_spare(3), _spare(7), _CROSSINGS >= 3)


def _simple(edges: np.ndarray) -> np.ndarray:
    """Edge mask of lines that are one pixel wide, without the corners of stairs, junctions, and the image's border.

    With corners, a line would be two: there along one side of its stairs, and back along the other.
    """
    mask = (edges > 0).astype(np.uint8)
    mask[:2], mask[-2:], mask[:, :2], mask[:, -2:] = 0, 0, 0, 0
    y, x = np.divmod(np.flatnonzero(mask.ravel() > 0), mask.shape[1])
    for cut in _CUTS:
        code = np.zeros(len(y), np.uint8)
        for bit, (dy, dx) in enumerate(_RING):
            code |= mask[y + dy, x + dx] << bit
        mask[y[cut[code]], x[cut[code]]] = 0
        y, x = y[~cut[code]], x[~cut[code]]
    return mask


def _link(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (n, 2) (x, y) in order along each thin line of the mask, and the line of each pixel."""
    traced, hierarchy = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    outer = np.reshape(hierarchy, (-1, 4))[:, 3] < 0 if len(traced) else []
    # the inner border of a loop is left out: its outer one is enough
    traces = [t.reshape(-1, 2) for t, o in zip(traced, outer, strict=True) if o and len(t) >= SHORTEST]
    if not traces:
        return np.zeros((0, 2), int), np.zeros(0, int)
    points, count = np.concatenate(traces), np.array([len(t) for t in traces])
    start = np.repeat(np.cumsum(count) - count, count)
    length, trace = np.repeat(count, count), np.repeat(np.arange(len(count)), count)
    step = np.arange(len(points)) - start
    key = points[:, 1].astype(np.int64) * mask.shape[1] + points[:, 0]
    # an open line is traced there and back: start at one of its ends
    turn = np.flatnonzero(key[start + (step - 1) % length] == key[start + (step + 1) % length])
    first = np.zeros(len(count), int)
    first[trace[turn[::-1]]] = step[turn[::-1]]
    order = start + (step + first[trace]) % length
    order = order[np.sort(np.unique(key[order], return_index=True)[1])]
    line, trace = points[order], trace[order]
    new = (np.abs(np.diff(line, axis=0)).max(axis=1) > 2) | (np.diff(trace) != 0)
    piece = np.cumsum(np.concatenate([[0], new]))
    long = np.bincount(piece)[piece] >= SHORTEST
    return line[long], np.unique(piece[long], return_inverse=True)[1]


def _subpixel(pixels: np.ndarray, dx: np.ndarray, dy: np.ndarray) -> Array:
    """Where the gradient's magnitude peaks along its direction (parabola through three samples; Devernay 1995)."""
    x, y = pixels.T
    gradient = np.stack([dx[y, x], dy[y, x]], axis=1).astype(float)
    direction = gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-9)
    at = (pixels[:, None] + direction[:, None] * np.array([-1.0, 0.0, 1.0])[:, None]).astype(np.float32)
    if len(pixels) == 0:
        return np.zeros((0, 2))
    sampled = [cv2.remap(d, at[..., 0], at[..., 1], cv2.INTER_LINEAR) for d in (dx, dy)]
    before, here, after = np.hypot(*sampled).T
    bend = before - 2 * here + after
    shift = np.where(bend < -1e-6, 0.5 * (before - after) / np.minimum(bend, -1e-6), 0.0)
    return pixels + direction * np.clip(shift, -0.75, 0.75)[:, None]


def _split_at_corners(positions: Array, chain: np.ndarray) -> tuple[Array, np.ndarray]:
    """Break chains where they turn sharply; drop what is too short; renumber."""
    n, reach = len(chain), CORNER_REACH
    if n <= 2 * reach:
        return positions[:0], chain[:0]
    ahead, behind = np.zeros((n, 2)), np.zeros((n, 2))
    ahead[:-reach] = positions[reach:] - positions[:-reach]
    behind[reach:] = ahead[:-reach]
    inside = np.zeros(n, bool)
    inside[reach:-reach] = (chain[2 * reach :] == chain[: -2 * reach]) & (
        chain[reach:-reach] == chain[2 * reach :]
    )
    cross = ahead[:, 0] * behind[:, 1] - ahead[:, 1] * behind[:, 0]
    turn = np.where(inside, np.abs(np.arctan2(cross, np.sum(ahead * behind, axis=1))), 0.0)
    peak = turn == np.max(
        np.lib.stride_tricks.sliding_window_view(np.pad(turn, reach), 2 * reach + 1), axis=1
    )
    corner = (turn > CORNER) & peak
    near = np.convolve(corner, np.ones(3), "same") > 0  # the pixels at a corner belong to neither side
    label = np.cumsum(np.concatenate([[0], (np.diff(chain) != 0) | np.diff(near.astype(int)).astype(bool)]))
    keep = ~near & (np.bincount(label)[label] >= SHORTEST)
    _, label = np.unique(label[keep], return_inverse=True)
    return positions[keep], label


def _directed(
    positions: Array, chain: np.ndarray, dx: np.ndarray, dy: np.ndarray, edges: np.ndarray
) -> Chains:
    """Chains turned round where most of their bright side is on the wrong hand."""
    if len(chain) == 0:
        return Chains(positions, chain, edges)
    x, y = np.rint(positions).astype(int).T
    tangent = np.gradient(positions, axis=0)
    left = tangent[:, 1] * dx[y, x] - tangent[:, 0] * dy[y, x]  # gradient along the left normal (ty, -tx)
    wrong = np.bincount(chain, np.sign(left)) < 0
    start = np.searchsorted(chain, chain)
    end = np.searchsorted(chain, chain, side="right") - 1
    index = np.arange(len(chain))
    return Chains(positions[np.where(wrong[chain], start + end - index, index)], chain, edges)

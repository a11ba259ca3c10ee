"""Slow twins of the maps of walls: cell by cell and shift by shift, Fourier transforms by their definition."""

from __future__ import annotations

import math

import numpy as np


def cell_of(x: float, y: float, cosine: float, sine: float, cell: float) -> tuple[int, int]:
    """Column and row of a turned place; the cell that both are named by begins half an edge before its middle."""
    turned = (cosine * x - sine * y) / cell, (sine * x + cosine * y) / cell
    return math.floor(turned[0] + 0.5), math.floor(turned[1] + 0.5)


def crossed_cells(ends: np.ndarray, reach: float, step: float, short: float, cell: float) -> set[tuple[int, int]]:
    """Cells from the middle on that the samples of all rays lie in."""
    found = set()
    for x, y in ends.tolist():
        length, at = math.sqrt(x**2 + y**2), 0.5 * step
        while at < min(length - short, reach):
            found.add(cell_of(at / length * x, at / length * y, 1.0, 0.0, cell))
            at += step
    return found


def images(
    points: np.ndarray, normals: np.ndarray, taken: np.ndarray, free: np.ndarray, angle: tuple[float, float],
    raster: tuple[float, int],
) -> np.ndarray:  # fmt: skip
    """Both images (2, S, S) of a turned map. angle: cosine and sine; raster: edge of a cell, cells along an edge."""
    (cosine, sine), (cell, size) = angle, raster
    drawn, of_cells = np.zeros((2, size, size), complex), dict[tuple[int, int], list[complex]]()
    for (x, y), (a, b) in zip(points.tolist(), normals.tolist(), strict=True):
        i, j = cell_of(x, y, cosine, sine, cell)
        of_cells.setdefault((i % size, j % size), []).append(complex(a, b) * complex(cosine, sine))
    for place, facing in of_cells.items():
        drawn[0][place] = sum(facing) / (len(facing) if len(facing) > 1 else 2)
    for middles, value in ((free, 1j), (taken, 1.0)):
        for x, y in middles.tolist():
            i, j = cell_of(x, y, cosine, sine, cell)
            drawn[1, i % size, j % size] = value
    return drawn


def turn_by_quarters(image: np.ndarray, quarters: int) -> np.ndarray:
    """The image (S, S) turned about cell (0, 0), as a map that goes around."""
    size = len(image)
    for _ in range(quarters):
        turned = np.empty_like(image)
        for i in range(size):
            for j in range(size):
                turned[-j % size, i] = image[i, j]
        image = turned
    return image


def transform(image: np.ndarray) -> np.ndarray:
    """Discrete Fourier transform (S, S)."""
    k = np.arange(len(image))
    waves = np.exp(-2j * np.pi * np.outer(k, k) / len(image))
    return waves @ image @ waves.T


def blurred(image: np.ndarray, cells: float) -> np.ndarray:
    """The image (S, S) with every wave damped like those of a bell of that width, in cells; no transform is made."""
    size = len(image)
    k = np.arange(size) - size // 2
    damped = np.exp(-2.0 * (np.pi * cells * k / size) ** 2)
    apart = np.arange(size)[:, None] - np.arange(size)
    bell = (damped * np.cos(2.0 * np.pi * apart[..., None] * k / size)).sum(-1) / size
    return bell @ image @ bell.T


def shift_scores(target: np.ndarray, source: np.ndarray, contradiction: float, blur: float) -> np.ndarray:
    """Score (S, S) of every shift: walls that face alike less walls where the other looked across, summed one by one.

    target, source: images (2, S, S) as drawn.
    """
    walls, (taken, free) = blurred(target[0], blur), (blurred(mask, blur) for mask in (target[1].real, target[1].imag))
    size = walls.shape[0]
    scores = np.empty((size, size))
    for i in range(size):
        for j in range(size):
            w, t, f = (np.roll(image, (-i, -j), (0, 1)) for image in (walls, taken, free))
            agreeing = w.real * source[0].real + w.imag * source[0].imag
            contradicting = f * source[1].real + t * source[1].imag
            scores[i, j] = agreeing.sum() - contradiction * contradicting.sum()
    return scores


def peaks(score: np.ndarray, num: int) -> list[tuple[float, int, int]]:
    """Value and place of the highest local maxima of a map that goes around; of equal ones the first by row."""
    size, found = len(score), []
    for i in range(size):
        for j in range(size):
            around = [score[(i + a) % size, (j + b) % size] for a in (-1, 0, 1) for b in (-1, 0, 1)]
            if score[i, j] == max(around):
                found.append((float(score[i, j]), i, j))
    return sorted(found, key=lambda peak: -peak[0])[:num]

"""Slow twins of the core's kernels in plain numpy: dense matrices, all pairs, no trees, no cells, no bit sets.

They take sums and differences in the order of the definitions, so that counts, index sets and most numbers must be
equal to the kernels' own, not merely near.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from svc_ros.core import se3

# --- spatial compatibility ------------------------------------------------------------------------------------


def length(vectors: np.ndarray) -> np.ndarray:
    """Euclidean length along the last axis, squares added from x to z."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.sqrt(x * x + y * y + z * z)


def length_differences(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """delta (N, N): | |x_i - x_j| - |y_i - y_j| |."""
    return np.abs(length(x[:, None] - x[None]) - length(y[:, None] - y[None]))


def first_order(x: np.ndarray, y: np.ndarray, threshold: float) -> np.ndarray:
    """A (N, N) float32, diagonal one."""
    delta = length_differences(x, y)
    ratio = delta / threshold
    return np.where(delta < threshold, 1.0 - ratio * ratio, 0.0).astype(np.float32)


def second_order(x: np.ndarray, y: np.ndarray, threshold: float) -> np.ndarray:
    """M (N, N): H * (G @ G), both diagonals one."""
    delta = length_differences(x, y)
    H, G = (delta < threshold).astype(np.int64), (delta < 0.5 * threshold).astype(np.int64)
    return H * (G @ G)


def unpack_bits(words: np.ndarray, num: int) -> np.ndarray:
    """Bit sets (N, W) as a matrix (N, num) of 0 and 1; bits beyond `num` must not be set."""
    bits = np.unpackbits(np.ascontiguousarray(words).view(np.uint8), axis=1, bitorder="little")
    assert not bits[:, num:].any()
    return bits[:, :num]


def power_iteration(A: np.ndarray, rounds: int) -> np.ndarray:
    """Leading eigenvector (N,) by power iteration from ones; own entry first, then the others in order."""
    num = len(A)
    others = A.astype(np.float64) * (1.0 - np.eye(num))
    vector = np.ones(num)
    for _ in range(rounds):
        terms = np.column_stack([vector, others * vector])
        product = np.cumsum(terms, axis=1)[:, -1]
        vector = product / np.sqrt(np.cumsum(product * product)[-1])
    return vector


def local_maxima(points: np.ndarray, score: np.ndarray, radius: float) -> np.ndarray:
    """Mask (N,): no point within the radius has a larger score."""
    delta = points[:, None] - points[None]
    near = (delta * delta).sum(-1) <= radius * radius
    return ~(near & (score[None] > score[:, None])).any(1)


def seeds(points: np.ndarray, score: np.ndarray, radius: float, limit: int) -> np.ndarray:
    """Local maxima by falling score, ties in order."""
    maxima = np.flatnonzero(local_maxima(points, score, radius))
    return maxima[np.argsort(-score[maxima], kind="stable")][:limit]


def largest(row: np.ndarray, k: int) -> np.ndarray:
    """Indices of the k largest positive entries, ties to the smaller index."""
    order = np.argsort(-row, kind="stable")[:k]
    return order[row[order] > 0]


def consensus_set(seed: int, delta: np.ndarray, M: np.ndarray, threshold: float, k1: int, k2: int) -> np.ndarray:
    """The k1 best of the seed's second-order row, and of those the k2 best by the measure inside the set."""
    members = largest(M[seed], k1)
    H = (delta < threshold).astype(np.int64)
    inside, with_seed = H[np.ix_(members, members)], H[seed, members]
    return members[largest(with_seed * (inside @ with_seed), k2)]


def set_weights(members: np.ndarray, x: np.ndarray, y: np.ndarray, threshold: float, rounds: int) -> np.ndarray:
    """Leading eigenvector of W_ab = max(0, 1 - delta_ab^2 / d_thr^2) with zero diagonal; zeros where W is zero."""
    ratio = length_differences(x[members], y[members]) / threshold
    W = np.maximum(0.0, 1.0 - ratio * ratio)
    np.fill_diagonal(W, 0.0)
    vector = np.ones(len(members))
    for _ in range(rounds):
        product = W @ vector
        if not product.any():
            return np.zeros(len(members))
        vector = product / np.linalg.norm(product)
    return vector


def pose_scores(T: np.ndarray, x: np.ndarray, y: np.ndarray, threshold: float) -> tuple[int, float, float]:
    """Inliers of one pose, and the sums over them of 1 - e / threshold and of its square, one by one."""
    count, mae, mse = 0, 0.0, 0.0
    for source, target in zip(x, y, strict=True):
        e = float(np.linalg.norm(T[:3, :3] @ source + T[:3, 3] - target))
        if e < threshold:
            count, mae, mse = count + 1, mae + (1 - e / threshold), mse + (1 - e / threshold) ** 2
    return count, mae, mse


# --- neighbours and matches -----------------------------------------------------------------------------------


def nearest_within(queries: np.ndarray, points: np.ndarray, radius: float) -> np.ndarray:
    """Index (M,) of the nearest point nearer than the radius, ties to the smaller index, -1 where there is none."""
    delta = points[None] - queries[:, None]
    x, y, z = np.moveaxis(delta, -1, 0)
    sq = x * x + y * y + z * z
    nearest = sq.argmin(1)
    return np.where(sq[np.arange(len(queries)), nearest] < radius * radius, nearest, -1)


def nearest_descriptors(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For each row of a the nearest of b, its distance, and the second nearest distance, by full distance matrix."""
    distance = np.linalg.norm(a[:, None].astype(np.float64) - b[None].astype(np.float64), axis=2)
    ordered = np.sort(distance, axis=1)
    second = ordered[:, 1] if len(b) > 1 else np.full(len(a), np.inf)
    return distance.argmin(1), ordered[:, 0], second


def mutual_matches(a: np.ndarray, b: np.ndarray) -> list[tuple[int, int]]:
    """Pairs (i, j), each the nearest of the other."""
    there, back = nearest_descriptors(a, b)[0], nearest_descriptors(b, a)[0]
    return [(i, int(j)) for i, j in enumerate(there) if back[j] == i]


# --- sight lines ----------------------------------------------------------------------------------------------


def paper_blocked(
    own: np.ndarray, placed: np.ndarray, tolerance: float, cone_cosine: float
) -> tuple[int, np.ndarray, np.ndarray]:
    """Algorithm 2 by all pairs: how many lines are in the region of interest, which are blocked, and by which point.

    own (N, 3) and placed (M, 3) are relative to the observer.
    """
    to_nearest = np.array([length(own - p).min() for p in placed])
    alone = np.flatnonzero(to_nearest > tolerance)
    in_roi, blocked, blockers = 0, [], []
    directions = placed[alone] / np.linalg.norm(placed[alone], axis=1)[:, None]
    ranges = np.linalg.norm(placed, axis=1)
    for i, q in enumerate(own):
        if len(alone) == 0:
            break
        direction = q / np.linalg.norm(q)
        nearest = int(length(directions - direction).argmin())
        if directions[nearest] @ direction <= cone_cosine:
            continue
        in_roi += 1
        if np.linalg.norm(q) - ranges[alone[nearest]] > tolerance:
            blocked.append(i)
            blockers.append(alone[nearest])
    return in_roi, np.array(blocked, np.int64), np.array(blockers, np.int64)


def line_blockers(
    p: np.ndarray, p_normals: np.ndarray, q: np.ndarray, q_normals: np.ndarray, limits: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """For each sight line q (N, 3) the nearest of the points p (M, 3) that blocks it or -1; whether any lies along it.

    The conditions of the default mode, each written out over all pairs; everything relative to the observer.
    """
    tolerance, radius, max_angle, max_tangent = limits
    blocker, observed = np.full(len(q), -1, np.int64), np.zeros(len(q), bool)
    p_range = length(p)
    with np.errstate(invalid="ignore"):
        cone = p_range * np.sin(np.minimum(np.arcsin(radius / p_range), max_angle))
    for i, (line, normal) in enumerate(zip(q, q_normals, strict=True)):
        q_range = length(line)
        along = (p[:, 0] * line[0] + p[:, 1] * line[1] + p[:, 2] * line[2]) / q_range
        sq_offset = p_range * p_range - along * along
        in_cone = (p_range > radius) & (along > 0) & (sq_offset <= cone * cone)
        observed[i] = in_cone.any()
        cosine = abs(line @ normal) / q_range
        tangent = min(np.sqrt(max(1 - cosine * cosine, 0)) / max(cosine, 1e-9), max_tangent)
        clearly_before = q_range - p_range > tolerance + np.sqrt(np.maximum(sq_offset, 0)) * tangent
        off_plane_of_q = np.abs((p - line) @ normal) > tolerance
        off_plane_of_p = np.abs(((p - line) * p_normals).sum(1)) > tolerance
        blocks = np.flatnonzero(in_cone & clearly_before & off_plane_of_q & off_plane_of_p)
        if len(blocks):
            blocker[i] = blocks[p_range[blocks].argmin()]
    return blocker, observed


def free_met(
    p: np.ndarray, p_normals: np.ndarray, rays: np.ndarray, limits: tuple[float, float, float, float, float]
) -> np.ndarray:
    """Mask (F,) of the unit rays that meet one of the points p (M, 3), relative to the observer, as it would see them.

    limits: beam radius, largest half angle, smallest range, range of a surface met head on, smallest cosine.
    """
    radius, max_angle, nearest, reach, min_cosine = limits
    p_range = length(p)
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = np.abs((p * p_normals).sum(1)) / p_range
    seen = (p_range > radius) & (p_range >= nearest) & (p_range <= reach * np.sqrt(cosine)) & (cosine >= min_cosine)
    cone = np.minimum(radius, p_range * np.sin(max_angle))
    met = np.zeros(len(rays), bool)
    for i, ray in enumerate(rays):
        along = p @ ray
        offset = length(p - along[:, None] * ray)
        met[i] = (seen & (along > 0) & (offset <= cone)).any()
    return met


# --- cheap look at many poses ---------------------------------------------------------------------------------


def num_agreeing(
    T: np.ndarray, source: tuple[np.ndarray, np.ndarray], target: tuple[np.ndarray, np.ndarray], radius: float,
    min_cosine: float,
) -> int:  # fmt: skip
    """Source points that the pose puts within the radius of a target point with an agreeing normal.

    source, target: points and normals.
    """
    placed, turned = (values @ T[:3, :3].T + shift for values, shift in zip(source, (T[:3, 3], 0.0), strict=True))
    nearest = nearest_within(placed, target[0], radius)
    near = nearest >= 0
    return int(((turned[near] * target[1][nearest[near]]).sum(1) > min_cosine).sum())


# --- ICP ------------------------------------------------------------------------------------------------------


def point_to_plane_icp(
    T: np.ndarray, source: np.ndarray, target: tuple[np.ndarray, np.ndarray], radius: float, rounds: int
) -> np.ndarray:
    """Pose (4, 4) after Gauss-Newton rounds on the planes (points, normals) nearest to the placed source points."""
    points, normals = target
    for _ in range(rounds):
        placed = source @ T[:3, :3].T + T[:3, 3]
        nearest = nearest_within(placed, points, radius)
        p, q, n = placed[nearest >= 0], points[nearest[nearest >= 0]], normals[nearest[nearest >= 0]]
        step = np.linalg.lstsq(np.hstack([n, np.cross(p, n)]), -((p - q) * n).sum(1), rcond=None)[0]
        moved = np.eye(4)
        moved[:3, :3], moved[:3, 3] = Rotation.from_rotvec(step[3:]).as_matrix(), step[:3]
        T = moved @ T
    return T


# --- refinement on correspondences ------------------------------------------------------------------------------


def refine_on_inliers(T: np.ndarray, x: np.ndarray, y: np.ndarray, threshold: float, eps: float, rounds: int):
    """The pose after weighted least squares on its inliers, again and again until their number stays the same."""
    previous = -1
    for _ in range(rounds):
        residual = length(x @ T[:3, :3].T + T[:3, 3] - y)
        inlier = residual < threshold
        if inlier.sum() in (previous, 0):
            break
        previous = int(inlier.sum())
        weights = 1.0 / (1.0 + (residual[inlier] / eps) ** 2)
        poses, valid = se3.kabsch(x[None, inlier], y[None, inlier], weights[None])
        if not valid[0]:
            break
        T = poses[0]
    return T


# --- place search -----------------------------------------------------------------------------------------------


def cross_spectra(wanted: np.ndarray, spectra: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cross spectra (N, F) of one spectrum (R, F) with many (N, R, F), summed over rings; and their weighted size."""
    cross = np.einsum("rf,nrf->nf", wanted.conj().astype(complex), spectra.astype(complex))
    return cross, np.abs(cross) @ weights

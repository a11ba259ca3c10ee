"""Hot loops on plain arrays, compiled by numba; no GIL, no state. Each has a slow twin in test/support/reference.py."""

from __future__ import annotations

import numpy as np

from svc_ros.core.compiling import kernel

_jit = kernel()


@_jit
def mark_compatible(first, last, x, y, threshold, loose, tight, counts):  # type: ignore[no-untyped-def]
    """Rows first..last of the bit sets H (loose) and G (tight), (N, W) uint64, zero before: bit j of row i.

    x, y (3, N): source and target points by axis; delta_ij < threshold and < threshold / 2, diagonal set;
    counts (N,): bits of the loose row without the diagonal.
    """
    n = x.shape[1]
    delta = np.empty(64 * loose.shape[1])
    delta[n:] = threshold
    for i in range(first, last):
        _length_differences(x, y, i, delta)
        count = -1
        for word in range(loose.shape[1]):
            near, nearer = np.uint64(0), np.uint64(0)
            for bit in range(64):
                near |= np.uint64(delta[64 * word + bit] < threshold) << np.uint64(bit)
            if near:
                for bit in range(64):
                    nearer |= np.uint64(delta[64 * word + bit] < 0.5 * threshold) << np.uint64(bit)
                count += int(popcount(near))
            loose[i, word], tight[i, word] = near, nearer
        counts[i] = count


@_jit
def _length_differences(x, y, i, delta):  # type: ignore[no-untyped-def]
    """delta (N,): | |x_i - x_j| - |y_i - y_j| |."""
    for j in range(x.shape[1]):
        ax, ay, az = x[0, i] - x[0, j], x[1, i] - x[1, j], x[2, i] - x[2, j]
        bx, by, bz = y[0, i] - y[0, j], y[1, i] - y[1, j], y[2, i] - y[2, j]
        delta[j] = abs(np.sqrt(ax * ax + ay * ay + az * az) - np.sqrt(bx * bx + by * by + bz * bz))


@_jit
def fill_compatible(first, last, x, y, threshold, loose, starts, columns, values):  # type: ignore[no-untyped-def]
    """Rows first..last of the first-order matrix A without its diagonal: columns, ascending, and values from starts."""
    one = np.uint64(1)
    for i in range(first, last):
        cursor = starts[i]
        for word in range(loose.shape[1]):
            bits = loose[i, word]
            j = 64 * word
            while bits:
                if bits & one and j != i:
                    ax, ay, az = x[0, i] - x[0, j], x[1, i] - x[1, j], x[2, i] - x[2, j]
                    bx, by, bz = y[0, i] - y[0, j], y[1, i] - y[1, j], y[2, i] - y[2, j]
                    delta = np.sqrt(ax * ax + ay * ay + az * az) - np.sqrt(bx * bx + by * by + bz * bz)
                    columns[cursor] = j
                    values[cursor] = np.float32(1.0 - (delta / threshold) ** 2)
                    cursor += 1
                bits >>= one
                j += 1


@_jit
def _length_difference(x, y, i, j):  # type: ignore[no-untyped-def]
    ax, ay, az = x[i, 0] - x[j, 0], x[i, 1] - x[j, 1], x[i, 2] - x[j, 2]
    bx, by, bz = y[i, 0] - y[j, 0], y[i, 1] - y[j, 1], y[i, 2] - y[j, 2]
    return np.sqrt(ax * ax + ay * ay + az * az) - np.sqrt(bx * bx + by * by + bz * bz)


@_jit
def leading_eigenvector(starts, columns, values, rounds, vector):  # type: ignore[no-untyped-def]
    """Power iteration on the sparse symmetric matrix A + I (as in SC2-PCR, whose diagonal is one), in `vector`."""
    n = vector.shape[0]
    product = np.empty(n)
    for _ in range(rounds):
        norm = 0.0
        for i in range(n):
            total = vector[i]
            for k in range(starts[i], starts[i + 1]):
                total += values[k] * vector[columns[k]]
            product[i] = total
            norm += total * total
        norm = np.sqrt(norm)
        for i in range(n):
            vector[i] = product[i] / norm


@_jit
def mark_local_maxima(first, last, points, score, radius, is_maximum):  # type: ignore[no-untyped-def]
    """is_maximum (N,), from first to last: no point within `radius` has a larger score. Scores descend."""
    sq_radius = radius * radius
    for i in range(first, last):
        is_maximum[i] = True
        for j in range(i):
            if score[j] <= score[i]:
                break
            dx, dy, dz = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1], points[i, 2] - points[j, 2]
            if dx * dx + dy * dy + dz * dz <= sq_radius:
                is_maximum[i] = False
                break


@_jit
def popcount(word):  # type: ignore[no-untyped-def]
    """Set bits of a uint64 (the form that LLVM turns into one instruction)."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + ((word >> np.uint64(2)) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (word * np.uint64(0x0101010101010101)) >> np.uint64(56)


@_jit
def second_order_row(seed, loose, tight, row):  # type: ignore[no-untyped-def]
    """row (N,) int32: M_sj = H_sj * sum_k G_sk G_kj of one seed."""
    num_words = tight.shape[1]
    row[:] = 0
    for word in range(num_words):
        bits = loose[seed, word]
        base = word * 64
        for bit in range(64):
            if (bits >> np.uint64(bit)) & np.uint64(1):
                j = base + bit
                common = np.uint64(0)
                for w in range(num_words):
                    common += popcount(tight[seed, w] & tight[j, w])
                row[j] = np.int32(common)


@_jit
def largest(row, order, k):  # type: ignore[no-untyped-def]
    """Write the indices of the k largest positive entries into order (k,), ties to the smaller one; return how many."""
    found = 0
    for j in range(row.shape[0]):
        value = row[j]
        if value <= 0 or (found == k and value <= row[order[found - 1]]):
            continue
        place = found if found < k else k - 1
        while place > 0 and row[order[place - 1]] < value:
            order[place] = order[place - 1]
            place -= 1
        order[place] = j
        found = min(found + 1, k)
    return found


@_jit
def consensus_sets(seeds, x, y, threshold, loose, tight, k1, k2, sets, sizes):  # type: ignore[no-untyped-def]
    """For each seed the k1 best by second-order measure, and of those the k2 best by the measure inside the set.

    sets: (S, k2) indices, sizes: (S,) how many of each row are valid.
    """
    n = x.shape[0]
    row = np.empty(n, np.int32)
    first = np.empty(k1, np.int64)
    inner = np.empty(k1, np.int32)
    second = np.empty(k2, np.int64)
    for s in range(seeds.shape[0]):
        second_order_row(seeds[s], loose, tight, row)
        size = largest(row, first, k1)
        inner_measure(seeds[s], x, y, threshold, first[:size], inner)
        kept = largest(inner[:size], second, min(k2, size))
        for a in range(kept):
            sets[s, a] = first[second[a]]
        sizes[s] = kept


@_jit
def inner_measure(seed, x, y, threshold, members, measure):  # type: ignore[no-untyped-def]
    """measure (k1,): H_sj * sum over k in the set of H_sk H_kj, of the members of one seed's first set."""
    size = members.shape[0]
    with_seed = np.empty(size, np.bool_)
    for a in range(size):
        with_seed[a] = abs(_length_difference(x, y, seed, members[a])) < threshold
    for a in range(size):
        count = 0
        if with_seed[a]:
            for b in range(size):
                if with_seed[b] and abs(_length_difference(x, y, members[a], members[b])) < threshold:
                    count += 1
        measure[a] = count


@_jit
def set_weights(sets, sizes, x, y, threshold, rounds, weights):  # type: ignore[no-untyped-def]
    """weights (S, k2): leading eigenvector of W_ab = max(0, 1 - delta_ab^2 / d_thr^2), zero diagonal, by rows."""
    num_sets, k = sets.shape
    matrix = np.zeros((k, k))
    vector = np.empty(k)
    product = np.empty(k)
    for s in range(num_sets):
        size = sizes[s]
        for a in range(size):
            vector[a] = 1.0
            matrix[a, a] = 0.0
            for b in range(a + 1, size):
                delta = _length_difference(x, y, sets[s, a], sets[s, b]) / threshold
                matrix[a, b] = matrix[b, a] = max(0.0, 1.0 - delta * delta)
        for _ in range(rounds):
            norm = 0.0
            for a in range(size):
                total = 0.0
                for b in range(size):
                    total += matrix[a, b] * vector[b]
                product[a] = total
                norm += total * total
            if norm == 0.0:
                break
            norm = np.sqrt(norm)
            for a in range(size):
                vector[a] = product[a] / norm
        for a in range(k):
            weights[s, a] = vector[a] if a < size and norm > 0.0 else 0.0


@_jit
def score_poses(T, x, y, threshold, num_inliers, mae, mse):  # type: ignore[no-untyped-def]
    """Per pose (H,): inliers e < threshold, and the sums over them of 1 - e / threshold and of its square."""
    sq_threshold = threshold * threshold
    for h in range(T.shape[0]):
        count, absolute, squared = 0, 0.0, 0.0
        for i in range(x.shape[0]):
            sq = 0.0
            for a in range(3):
                e = T[h, a, 0] * x[i, 0] + T[h, a, 1] * x[i, 1] + T[h, a, 2] * x[i, 2] + T[h, a, 3] - y[i, a]
                sq += e * e
            if sq < sq_threshold:
                closeness = 1.0 - np.sqrt(sq) / threshold
                count += 1
                absolute += closeness
                squared += closeness * closeness
        num_inliers[h] = count
        mae[h] = absolute
        mse[h] = squared

"""Compiled passes over images and features of a network in bfloat16, which Numba handles as 16-bit words.

Convolution inputs are in channels-last memory, in which the channels of a pixel are contiguous; images are planes of
float32. Each kernel reads and writes all data once. Sums are computed in float32.

Axes: n images, r references, c channels, h height, w width, i = h / 2, j = w / 2.
"""

from typing import no_type_check

import numpy as np
from numba import prange

from gaussian_enhancer.compiled import exp2_nonpositive, inner, kernel

_F = np.float32
_ZERO, _ONE, _HALF, _QUARTER = _F(0), _F(1), _F(0.5), _F(0.25)
_U = np.uint32
_SIXTEEN, _LAST, _ROUND, _HIGH = _U(16), _U(1), _U(0x7FFF), _U(0xFFFF0000)
_LOG2E = _F(1.4426950408889634)


@inner
@no_type_check
def round_to_bfloat16(value):
    """Bits of the nearest bfloat16 in the upper half of a 32-bit word, ties to even."""
    bits = _F(value).view(_U)
    return _U(_U(bits + _ROUND + _U(_U(bits >> _SIXTEEN) & _LAST)) & _HIGH)


@inner
@no_type_check
def pack_pair(first, second):
    """Two values as one word of two bfloat16; the first value is at the lower address."""
    return _U(_U(round_to_bfloat16(first) >> _SIXTEEN) | round_to_bfloat16(second))


@inner
@no_type_check
def to_bfloat16(value):
    """Convert a value to bfloat16."""
    return np.uint16(round_to_bfloat16(value) >> _SIXTEEN)


@inner
@no_type_check
def to_float32(value):
    """Convert a bfloat16 to float32."""
    return _U(_U(value) << _SIXTEEN).view(_F)


@kernel
@no_type_check
def pack_planes(image, shift, mask, result):
    """Write pixel-unshuffled planes plus a shift, then a mask, as words of two pixels: (n, i, j, 2 (c + 1))."""
    count, channels, height, _ = image.shape
    for row in prange(count * (height // 2)):
        n, i = row // (height // 2), row % (height // 2)
        for c in range(channels):
            _pack_row(image[n, c, 2 * i], shift, result[n, i], 2 * c)
            _pack_row(image[n, c, 2 * i + 1], shift, result[n, i], 2 * c + 1)
        _pack_row(mask[n, 0, 2 * i], _ZERO, result[n, i], 2 * channels)
        _pack_row(mask[n, 0, 2 * i + 1], _ZERO, result[n, i], 2 * channels + 1)


@inner
@no_type_check
def _pack_row(row, shift, result, place):
    for j in range(len(result)):
        result[j, place] = pack_pair(row[2 * j] + shift, row[2 * j + 1] + shift)


@kernel
@no_type_check
def pack_references(photos, renders, visibility, has_renders, low, high, result):
    """Write photo - 1/2, visibility, photo - render and a flag, pixel-unshuffled by 2, as (r, i, j, 16) words.

    Photos and renders are clamped to the range from ``low`` to ``high``.
    """
    count, _, height, width = photos.shape
    flag = pack_pair(has_renders, has_renders)
    for row in prange(count * (height // 2)):
        n, i = row // (height // 2), row % (height // 2)
        for j in range(width // 2):
            x = 2 * j
            for a in range(2):
                y = 2 * i + a
                for c in range(3):
                    first = min(max(photos[n, c, y, x], low), high)
                    second = min(max(photos[n, c, y, x + 1], low), high)
                    result[n, i, j, 2 * c + a] = pack_pair(first - _HALF, second - _HALF)
                    first_residual = first - min(max(renders[n, c, y, x], low), high)
                    second_residual = second - min(max(renders[n, c, y, x + 1], low), high)
                    result[n, i, j, 8 + 2 * c + a] = pack_pair(
                        has_renders * first_residual, has_renders * second_residual
                    )
                result[n, i, j, 6 + a] = pack_pair(visibility[n, 0, y, x], visibility[n, 0, y, x + 1])
                result[n, i, j, 14 + a] = flag


@kernel
@no_type_check
def pack_depth(depth, unit, farthest, result, share):
    """Write unit / depth within [0, 4] and the mask of usable depth, pixel-unshuffled by 2, and the usable share."""
    height, width = depth.shape
    for i in prange(height // 2):
        for j in range(width // 2):
            usable_sum = _ZERO
            for a in range(2):
                first, second = depth[2 * i + a, 2 * j], depth[2 * i + a, 2 * j + 1]
                first_usable, second_usable = _usable(first, farthest), _usable(second, farthest)
                result[i, j, a] = pack_pair(_inverse(first, first_usable, unit), _inverse(second, second_usable, unit))
                result[i, j, 2 + a] = pack_pair(first_usable, second_usable)
                usable_sum += first_usable + second_usable
            share[i, j] = _QUARTER * usable_sum


@inner
@no_type_check
def _usable(depth, farthest):
    return _ONE if depth > _ZERO and depth <= farthest else _ZERO


@inner
@no_type_check
def _inverse(depth, usable, unit):
    return min(unit / depth, _F(4)) if usable > _ZERO else _ZERO


@kernel
@no_type_check
def modulate(features, modulation, share, result):
    """Write features + share (features scale + shift); scale and shift are halves of ``modulation``'s channels."""
    count, height, width, channels = features.shape
    for row in prange(count * height):
        n, i = row // height, row % height
        for j in range(width):
            usable_share = share[n, i, j]
            for c in range(channels):
                value = to_float32(features[n, i, j, c])
                scale, shift = to_float32(modulation[n, i, j, c]), to_float32(modulation[n, i, j, channels + c])
                result[n, i, j, c] = to_bfloat16(value + usable_share * (value * scale + shift))


@kernel
@no_type_check
def weigh(logits, values, visibility, limit, fused, trust):
    """Write sum_i w_i value_i to ``fused``, and the mean over heads of w_i to ``trust``.

    w_i = v_i exp(l_i) / (1 + sum_j v_j exp(l_j)), where l are the logits bounded by ``limit``.
    logits (n, r, i, j, heads) and values (n, r, i, j, c) are bfloat16, visibility and trust (n, r, i, j) float32.
    """
    batch, count, height, width, heads = logits.shape
    channels = values.shape[4]
    exp_limit = _F(np.exp(limit))
    for row in prange(batch * height):
        n, i = row // height, row % height
        weight = np.empty((count, width * heads), np.float32)
        total = np.ones(width * heads, np.float32)
        visible = np.empty(width * heads, np.float32)
        for r in range(count):
            _repeat(visibility[n, r, i], heads, visible)
            _score(logits[n, r, i].reshape(width * heads), visible, limit, exp_limit, weight[r], total)
        for q in range(width * heads):
            total[q] = _ONE / total[q]
        weighted_sum = np.zeros(width * channels, np.float32)
        repeated = np.empty(width * channels, np.float32)
        for r in range(count):
            for q in range(width * heads):
                weight[r, q] *= total[q]
            _repeat(weight[r], channels // heads, repeated)
            _add_products(repeated, values[n, r, i].reshape(width * channels), weighted_sum)
            for j in range(width):
                mean = _ZERO
                for k in range(heads):
                    mean += weight[r, j * heads + k]
                trust[n, r, i, j] = mean / _F(heads)
        _convert_to_bfloat16(weighted_sum, fused[n, i].reshape(width * channels))


@inner
@no_type_check
def _repeat(values, times, result):
    """Write each value several times in a row, so that loops over the result vectorise without a gather."""
    for j in range(len(values)):
        for k in range(times):
            result[j * times + k] = values[j]


@inner
@no_type_check
def _score(logits, visibility, limit, exp_limit, weight, total):
    """Write v exp(l), l = limit tanh(logit / limit), and add it to a total; ``exp_limit`` is exp(limit)."""
    for q in range(len(logits)):
        logit = to_float32(logits[q])
        e = exp2_nonpositive(-_F(2) * _LOG2E * abs(logit) / limit)
        t = (_ONE - e) / (_ONE + e)
        t = t if logit > _ZERO else -t
        score = visibility[q] * (exp_limit * exp2_nonpositive(limit * _LOG2E * (t - _ONE)))
        weight[q] = score
        total[q] += score


@inner
@no_type_check
def _add_products(weight, values, total):
    for q in range(len(values)):
        total[q] += weight[q] * to_float32(values[q])


@inner
@no_type_check
def _convert_to_bfloat16(values, result):
    for q in range(len(values)):
        result[q] = to_bfloat16(values[q])


@kernel
@no_type_check
def shuffle(features, result):
    """Pixel-shuffle by 2: channels (n, i, j, 4 c) become 2x2 pixels of planes, (n, c, 2 i, 2 j)."""
    count, height, width, channels = features.shape
    for row in prange(count * height):
        n, i = row // height, row % height
        for c in range(channels // 4):
            for j in range(width):
                for a in range(2):
                    result[n, c, 2 * i + a, 2 * j] = features[n, i, j, 4 * c + 2 * a]
                    result[n, c, 2 * i + a, 2 * j + 1] = features[n, i, j, 4 * c + 2 * a + 1]


@kernel
@no_type_check
def shuffle_and_add(features, skip, result):
    """As `shuffle`, but with output in channels-last memory, (n, 2 i, 2 j, c), plus ``skip``."""
    count, height, width, channels = skip.shape
    for row in prange(count * height):
        n, y = row // height, row % height
        for x in range(width):
            phase = 2 * (y % 2) + x % 2
            for c in range(channels):
                value = to_float32(features[n, y // 2, x // 2, 4 * c + phase])
                result[n, y, x, c] = to_bfloat16(value + to_float32(skip[n, y, x, c]))


@kernel
@no_type_check
def add_and_rectify(references, target):
    """Write relu(references + target) to references, (n, r, i, j, c), in place; target is (n, i, j, c)."""
    batch, count, height, width, channels = references.shape
    for row in prange(batch * count * height):
        n, r, i = row // (count * height), row // height % count, row % height
        for j in range(width):
            for c in range(channels):
                references[n, r, i, j, c] = to_bfloat16(
                    max(to_float32(references[n, r, i, j, c]) + to_float32(target[n, i, j, c]), _ZERO)
                )


@kernel
@no_type_check
def pool(references, visibility, result):
    """Write the visibility-weighted mean of references (n, r, i, j, c), and the sum of visibility (n, r, i, j) / 3."""
    batch, count, height, width, channels = references.shape
    for row in prange(batch * height):
        n, i = row // height, row % height
        total = np.zeros(width, np.float32)
        for r in range(count):
            for j in range(width):
                total[j] += visibility[n, r, i, j]
        weighted_sum = np.zeros(width * channels, np.float32)
        weight = np.empty(width, np.float32)
        repeated = np.empty(width * channels, np.float32)
        for r in range(count):
            for j in range(width):
                weight[j] = (_ONE / max(total[j], _F(1e-3))) * visibility[n, r, i, j]
            _repeat(weight, channels, repeated)
            _add_products(repeated, references[n, r, i].reshape(width * channels), weighted_sum)
        for j in range(width):
            for c in range(channels):
                result[n, i, j, c] = to_bfloat16(weighted_sum[j * channels + c])
            result[n, i, j, channels] = to_bfloat16(total[j] / _F(3))


@kernel
@no_type_check
def shrink(photos, renders, visibility, has_renders, small_photos, small_renders, share):
    """Write visibility-weighted means of photos and renders over 2x2 pixels, and the mean visibility."""
    count, _, height, width = photos.shape
    for row in prange(count * (height // 2)):
        n, i = row // (height // 2), row % (height // 2)
        y = 2 * i
        above, below, mean = visibility[n, 0, y], visibility[n, 0, y + 1], share[n, 0, i]
        for j in range(width // 2):
            mean[j] = _QUARTER * (above[2 * j] + below[2 * j] + (above[2 * j + 1] + below[2 * j + 1]))
        for c in range(3):
            _shrink_row(photos[n, c, y], photos[n, c, y + 1], above, below, mean, small_photos[n, c, i])
            if has_renders > _ZERO:
                _shrink_row(renders[n, c, y], renders[n, c, y + 1], above, below, mean, small_renders[n, c, i])


@inner
@no_type_check
def _shrink_row(upper, lower, upper_weight, lower_weight, share, result):
    for j in range(len(result)):
        x, right = 2 * j, 2 * j + 1
        total = upper[x] * upper_weight[x] + lower[x] * lower_weight[x]
        total += upper[right] * upper_weight[right] + lower[right] * lower_weight[right]
        result[j] = _QUARTER * total / max(share[j], _F(1e-6)) if share[j] > _ZERO else _ZERO


@kernel
@no_type_check
def compose(decoded, render, photos, renders, visibility, trust, has_renders, result):
    """Write render + confidence x residual + sum_i trust_i (g (photo_i - render) + k (photo_i - render_i)).

    decoded is bfloat16 (6, h, w), trust (r, i, j); the others are float32. renders are only read if has_renders > 0.
    """
    count, _, height, width = photos.shape
    for y in prange(height):
        weight = np.empty((count, width), np.float32)
        for r in range(count):
            double_row(trust[r], y, weight[r])
            for x in range(width):
                weight[r, x] = weight[r, x] if visibility[r, 0, y, x] > _ZERO else _ZERO
        for c in range(3):
            added, residual = np.zeros(width, np.float32), np.zeros(width, np.float32)
            for r in range(count):
                _add_difference(added, weight[r], photos[r, c, y], render[c, y])
                if has_renders > _ZERO:
                    _add_difference(residual, weight[r], photos[r, c, y], renders[r, c, y])
            for x in range(width):
                change = _sigmoid(to_float32(decoded[3, y, x])) * to_float32(decoded[c, y, x])
                change += to_float32(decoded[4, y, x]) * added[x] + to_float32(decoded[5, y, x]) * residual[x]
                result[c, y, x] = render[c, y, x] + change


@inner
@no_type_check
def _add_difference(total, weight, first, second):
    for x in range(len(total)):
        total[x] += weight[x] * (first[x] - second[x])


@inner
@no_type_check
def _sigmoid(value):
    e = exp2_nonpositive(-_LOG2E * abs(value))
    return (_ONE if value > _ZERO else e) / (_ONE + e)


@inner
@no_type_check
def double_row(image, y, result):
    """Row y of an image at twice its resolution, interpolated linearly between pixel centres."""
    height, width = image.shape
    i = y // 2
    neighbour = min(max(i - 1 if y % 2 == 0 else i + 1, 0), height - 1)
    column = np.empty(width, np.float32)
    for j in range(width):
        column[j] = _F(0.75) * image[i, j] + _QUARTER * image[neighbour, j]
    result[0], result[2 * width - 1] = column[0], column[width - 1]
    for j in range(1, width):
        result[2 * j] = _F(0.75) * column[j] + _QUARTER * column[j - 1]
    for j in range(width - 1):
        result[2 * j + 1] = _F(0.75) * column[j] + _QUARTER * column[j + 1]


@kernel
@no_type_check
def pack_combination(fine, render, coarser, result):
    """Write fine - render, pixel-unshuffled by 2, then the values of coarser scales: (i, j, 12 + d) bfloat16."""
    count, height, width = coarser.shape
    for i in prange(height):
        for j in range(width):
            for c in range(3):
                for a in range(2):
                    for b in range(2):
                        y, x = 2 * i + a, 2 * j + b
                        result[i, j, 4 * c + 2 * a + b] = to_bfloat16(fine[c, y, x] - render[c, y, x])
            for d in range(count):
                result[i, j, 12 + d] = to_bfloat16(coarser[d, i, j])


@kernel
@no_type_check
def combine(fine, decoded, coarser, step, result):
    """Write fine + up(sum_k g_k change_k) + residual.

    decoded (i, j, 12 + k) holds the residual of 2x2 pixels and the gains; change k is ``coarser`` from channel k x step
    on.
    """
    height, width, channels = decoded.shape
    change = np.empty((3, height, width), np.float32)
    for i in prange(height):
        for c in range(3):
            for j in range(width):
                total = _ZERO
                for k in range(channels - 12):
                    total += to_float32(decoded[i, j, 12 + k]) * coarser[k * step + c, i, j]
                change[c, i, j] = total
    for y in prange(2 * height):
        row = np.empty(2 * width, np.float32)
        for c in range(3):
            double_row(change[c], y, row)
            first_row = 4 * c + 2 * (y % 2)
            for j in range(width):
                x = 2 * j
                result[c, y, x] = fine[c, y, x] + row[x] + to_float32(decoded[y // 2, j, first_row])
                result[c, y, x + 1] = fine[c, y, x + 1] + row[x + 1] + to_float32(decoded[y // 2, j, first_row + 1])

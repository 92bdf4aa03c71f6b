"""Compiled nearest neighbours: points are sorted along one axis and scanned outwards from each point.

The scan ends where the distance along that axis alone exceeds the distance to the third-nearest point so far.
"""

from typing import no_type_check

import numpy as np
from numba import prange

from gaussian_enhancer.compiled import kernel


@kernel
@no_type_check
def nearest_three(points, axis, mean_squared):
    """Mean squared distance to the three nearest other points, or to all if fewer; points are sorted along axis."""
    count = points.shape[0]
    for i in prange(count):
        best = np.full(3, np.inf)
        left, right = i - 1, i + 1
        while left >= 0 or right < count:
            gap_left = points[i, axis] - points[left, axis] if left >= 0 else np.inf
            gap_right = points[right, axis] - points[i, axis] if right < count else np.inf
            if min(gap_left, gap_right) ** 2 >= best[2]:
                break
            j = left if gap_left <= gap_right else right
            if gap_left <= gap_right:
                left -= 1
            else:
                right += 1
            distance = 0.0
            for k in range(3):
                distance += (points[i, k] - points[j, k]) ** 2
            if distance < best[2]:
                best[2] = distance
                if best[2] < best[1]:
                    best[1], best[2] = best[2], best[1]
                if best[1] < best[0]:
                    best[0], best[1] = best[1], best[0]
        neighbour_count = min(3, count - 1)
        mean_squared[i] = best[:neighbour_count].sum() / neighbour_count

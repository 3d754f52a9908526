"""The static world, compiled: does the body at a pose touch a boundary, is its centre allowed, is the goal reached."""

import math

import numba as nb
import numpy as np


@nb.njit(cache=True, error_model="numpy")
def path_free(x0, y0, h0, poses, count, world):
    """`body_free` at the first poses (S, ≥ 3) and between them, from (x0, y0, h0) on, at most half a body length apart.

    One loop over numbers: to pass the arrays on for every pose would take longer, by their references, than the test.
    """
    half_length, half_width, bounds, origin, cell, cells_x, cells_y, start, items, segments, inside = world
    everywhere = segments.shape[0] == 0
    for pose in range(count):
        x1, y1, h1 = poses[pose, 0], poses[pose, 1], poses[pose, 2]
        parts = int(math.hypot(x1 - x0, y1 - y0) / half_length) + 1
        turn = (h1 - h0 + math.pi) % (2.0 * math.pi) - math.pi
        for part in range(1, parts + 1):
            share = part / parts
            x, y, heading = x0 + share * (x1 - x0), y0 + share * (y1 - y0), h0 + share * turn
            if x < bounds[0] or y < bounds[1] or x > bounds[2] or y > bounds[3]:
                return False
            if everywhere:
                if not inside[0]:
                    return False
                continue
            i = int((x - origin[0]) / cell)
            j = int((y - origin[1]) / cell)
            if i < 0 or j < 0 or i >= cells_x or j >= cells_y:
                return False
            index = i * cells_y + j
            odd = False
            if start[index] < start[index + 1]:
                mx, my = origin[0] + (i + 0.5) * cell, origin[1] + (j + 0.5) * cell
                cos, sin = math.cos(heading), math.sin(heading)
                for n in range(start[index], start[index + 1]):
                    e = items[n]
                    s = segments[e, 0], segments[e, 1], segments[e, 2], segments[e, 3]
                    if half_width < 0.0:
                        if _within(s, x, y, half_length):
                            return False
                    elif _clips(s, x, y, cos, sin, half_length, half_width):
                        return False
                    if _crosses(x, y, mx, my, s):
                        odd = not odd
            if inside[index] == odd:
                return False
        x0, y0, h0 = x1, y1, h1
    return True


@nb.njit(cache=True, error_model="numpy")
def body_free(x, y, heading, world):
    """Whether the rectangle touches no boundary segment and its centre is allowed; a disc where half_width < 0.

    `world` is packed (see `riskplan.world`): half_length, half_width, bounds, origin, cell, cells_x, cells_y, start,
    items, segments, inside. Segments (E, 4) are bucketed in square cells: start (cells+1,), items; every segment that
    the body of a car centred in a cell can touch is listed there. inside (cells,): whether the cell's middle is
    allowed; the centre's own side follows from the parity of crossings between the two.
    """
    return path_free(x, y, heading, np.array([[x, y, heading]]), 1, world)


@nb.njit(inline="always", error_model="numpy")
def _clips(s, x, y, cos, sin, half_length, half_width):
    """Liang & Barsky (1984): does the segment meet the rectangle?"""
    ax, ay = s[0] - x, s[1] - y
    bx, by = s[2] - x, s[3] - y
    px, py = cos * ax + sin * ay, cos * ay - sin * ax
    dx, dy = cos * bx + sin * by - px, cos * by - sin * bx - py
    low, high = 0.0, 1.0
    for axis in range(2):
        p, d, half = (px, dx, half_length) if axis == 0 else (py, dy, half_width)
        if d == 0.0:
            if abs(p) > half:
                return False
        else:
            first, second = (-half - p) / d, (half - p) / d
            low = max(low, min(first, second))
            high = min(high, max(first, second))
            if low > high:
                return False
    return True


@nb.njit(inline="always", error_model="numpy")
def _within(s, x, y, radius):
    """Does the segment meet the disc?"""
    dx, dy = s[2] - s[0], s[3] - s[1]
    along = (x - s[0]) * dx + (y - s[1]) * dy
    share = min(max(along / (dx * dx + dy * dy), 0.0), 1.0)
    ex, ey = s[0] + share * dx - x, s[1] + share * dy - y
    return ex * ex + ey * ey <= radius * radius


@nb.njit(inline="always", error_model="numpy")
def _crosses(ax, ay, bx, by, s):
    """Proper crossing of a–b with the segment; half-open at its ends so that a shared vertex counts once."""
    c = (bx - ax) * (s[1] - ay) - (by - ay) * (s[0] - ax)
    d = (bx - ax) * (s[3] - ay) - (by - ay) * (s[2] - ax)
    if (c > 0.0) == (d > 0.0):
        return False
    e = (s[2] - s[0]) * (ay - s[1]) - (s[3] - s[1]) * (ax - s[0])
    f = (s[2] - s[0]) * (by - s[1]) - (s[3] - s[1]) * (bx - s[0])
    return (e > 0.0) != (f > 0.0)


@nb.njit(cache=True, error_model="numpy")
def in_polygon(x, y, polygon):
    """Even–odd rule for a polygon (N, 2)."""
    inside = False
    j = polygon.shape[0] - 1
    for i in range(polygon.shape[0]):
        yi, yj = polygon[i, 1], polygon[j, 1]
        if (yi > y) != (yj > y) and x < (polygon[j, 0] - polygon[i, 0]) * (y - yi) / (yj - yi) + polygon[i, 0]:
            inside = not inside
        j = i
    return inside


@nb.njit(cache=True, error_model="numpy")
def goal_region(x, y, heading, speed, start, vertices, boxes, terms):
    """Index of a goal region that holds the state, or −1.

    start (R+1,), vertices (V, 2), boxes (R, 4), terms (R, 4): heading (NaN: any), tolerance, lowest and highest speed.
    """
    for r in range(boxes.shape[0]):
        b, t = boxes[r], terms[r]
        if x < b[0] or y < b[1] or x > b[2] or y > b[3] or speed < t[2] or speed > t[3]:
            continue
        if not math.isnan(t[0]):
            off = (heading - t[0] + math.pi) % (2.0 * math.pi) - math.pi
            if abs(off) > t[1]:
                continue
        if in_polygon(x, y, vertices[start[r] : start[r + 1]]):
            return r
    return -1


@nb.njit(cache=True, error_model="numpy")
def goal_distances(points, start, vertices, boxes, out):
    """Fill out (N,) with the distance of points (N, 2) to the nearest of the polygons; 0 inside."""
    for n in range(points.shape[0]):
        x, y = points[n, 0], points[n, 1]
        best = np.inf
        for r in range(start.shape[0] - 1):
            b = boxes[r]
            if math.hypot(max(b[0] - x, 0.0, x - b[2]), max(b[1] - y, 0.0, y - b[3])) >= best:
                continue
            polygon = vertices[start[r] : start[r + 1]]
            if in_polygon(x, y, polygon):
                best = 0.0
                break
            j = polygon.shape[0] - 1
            for i in range(polygon.shape[0]):
                ax, ay = polygon[j, 0], polygon[j, 1]
                dx, dy = polygon[i, 0] - ax, polygon[i, 1] - ay
                squared = dx * dx + dy * dy
                share = ((x - ax) * dx + (y - ay) * dy) / squared if squared > 0.0 else 0.0
                share = min(max(share, 0.0), 1.0)
                best = min(best, math.hypot(x - ax - share * dx, y - ay - share * dy))
                j = i
        out[n] = best


@nb.njit(cache=True, error_model="numpy")
def bucket_segments(segments, origin, cell, cells_x, cells_y, reach):
    """(start, items): per cell the segments whose bounding box, widened by `reach`, touches it."""
    count = np.zeros(cells_x * cells_y + 1, np.int64)
    for fill in range(2):
        if fill:
            count = np.cumsum(count)
            items = np.empty(count[-1], np.int64)
            cursor = count.copy()
        for e in range(segments.shape[0]):
            s = segments[e]
            i0 = int((min(s[0], s[2]) - reach - origin[0]) // cell)
            i1 = int((max(s[0], s[2]) + reach - origin[0]) // cell)
            j0 = int((min(s[1], s[3]) - reach - origin[1]) // cell)
            j1 = int((max(s[1], s[3]) + reach - origin[1]) // cell)
            for i in range(max(i0, 0), min(i1, cells_x - 1) + 1):
                for j in range(max(j0, 0), min(j1, cells_y - 1) + 1):
                    index = i * cells_y + j
                    if fill:
                        items[cursor[index]] = e
                        cursor[index] += 1
                    else:
                        count[index + 1] += 1
    return count, items

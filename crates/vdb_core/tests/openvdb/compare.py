"""Compares grids of two files by OpenVDB's own Python module.

Standard input has one grid a line: the two paths and the name, with tabs between. Every value that
both trees store, active or not, and the transforms must be the same. Prints how much was compared,
and fails at the first difference.
"""

import itertools
import math
import sys

import pyopenvdb

# Enough of the largest files: Python takes a microsecond or two a value.
MOST = 40_000


def same(a, b):
    if isinstance(a, tuple):
        return all(map(same, a, b))
    if isinstance(a, float) and math.isnan(a):
        return math.isnan(b)
    return a == b and math.copysign(1, a) == math.copysign(1, b)


def values(grid):
    return itertools.islice(grid.citerAllValues(), MOST)


def compare(first, second, name):
    a, b = (pyopenvdb.read(path, name) for path in (first, second))
    where = f"{second}, grid {name!r}"
    assert type(a) is type(b), where
    assert a.gridClass == b.gridClass, where
    assert a.saveFloatAsHalf == b.saveFloatAsHalf, where
    assert same(a.background, b.background), where
    assert a.transform.typeName == b.transform.typeName, where
    for point in [(0, 0, 0), (1, 2, 3), (-70, 50, 1000)]:
        world = [grid.transform.indexToWorld(point) for grid in (a, b)]
        assert same(*world), (where, world)
        index = [grid.transform.worldToIndex(point) for grid in (a, b)]
        assert same(*index), (where, index)
    compared = 0
    for x, y in itertools.zip_longest(values(a), values(b)):
        assert x is not None and y is not None, where
        assert (x.min, x.max, x.active, x.depth) == (y.min, y.max, y.active, y.depth), where
        assert same(x.value, y.value), (where, x.min, x.value, y.value)
        compared += 1
    return compared


grids = compared = 0
for line in sys.stdin:
    compared += compare(*line.rstrip("\n").split("\t"))
    grids += 1
print(f"{grids} grids, {compared} values")

"""Cells of a map in little memory: two bits per cell, and two or four bytes per free cell.

A key is a layer of heights and an orientation group. Its cells are numbered (yaw, x, y), the last index fastest: a
*local* number. One bit tells whether the cell's centre is reached, another whether it is reached free of
self-collision. Keys without any cell share one block of zeros. The free cells, in this order, have a code: the number
of a level of μ in `levels`, and the number of the torso height. Up to `EXACT` free cells every value of μ is a level.
Larger maps have evenly spaced levels, as many as fit in two bytes with the torso height. μ is rounded down to a level.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.compilation import WITHOUT_REFERENCE_COUNTS, njit
from irm.grid import MapGrid

Singles = NDArray[np.float32]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]
Words = NDArray[np.uint64]
EXACT = 2_000_000
"""Most free cells for which every value of μ is stored exactly."""
_BLOCK = 4
"""Words per stored count of the free cells before them. A look-up counts the bits of at most four words."""


class PackedCells(NamedTuple):
    """Cells of a map, for kernels. Arrays are read-only.

    `offset` (keys,): first word of each key in `reached` and `free` (w,), the bits of the cells. `before` (w / 4,):
    number of free cells before each four words. `codes` (m,): codes of the free cells, the number of the level of μ
    times 2^`torso_bits`, plus the number of the torso height. `levels` (l,): values of μ, increasing.
    """

    offset: Integers
    reached: Words
    free: Words
    before: NDArray[np.uint32]
    codes: NDArray[Any]
    levels: Singles
    torso_bits: int


def pack_cells(grid: MapGrid, reached: Bools, free: Bools, mu: Singles, torso: NDArray[np.uint8]) -> PackedCells:
    """Pack the cells of a map.

    Args:
        grid: of the map.
        reached, free: (layers, orientations, x, y) whether a cell is reached, and free of self-collision.
        mu, torso: (m,) μ > 0 and the number of the torso height of the free cells, in the order of the cells.
    """
    levels, torso_bits = np.unique(mu), max(0, len(grid.torsos) - 1).bit_length()
    kind: Any = np.uint32
    if len(mu) > EXACT and torso_bits <= 8:
        kind, most = np.uint16, 1 << (16 - torso_bits)
        if len(levels) > most:
            levels = np.linspace(levels[0], levels[-1], most, dtype=np.float32)
    level = (np.searchsorted(levels, mu, side="right") - 1).astype(np.uint32)
    codes = ((level << np.uint32(torso_bits)) | torso).astype(kind)
    return join_cells(grid, _bytes(reached), _bytes(free), codes, levels)


def join_cells(
    grid: MapGrid, reached: NDArray[np.uint8], free: NDArray[np.uint8], codes: NDArray[Any], levels: Singles
) -> PackedCells:
    """Pack the cells of a map file: bits of all cells in order, (⌈cells / 8⌉,) bytes, and codes and levels."""
    offset, size = np.zeros(len(key_sizes(grid)), np.int64), key_sizes(grid)
    words = -(-size // (64 * _BLOCK)) * _BLOCK
    bits = [np.unpackbits(column, count=grid.size, bitorder="little").view(np.bool_) for column in (reached, free)]
    first = np.concatenate([[0], np.cumsum(size)])
    used = np.flatnonzero([bits[0][first[key] : first[key + 1]].any() for key in range(len(size))])
    offset[used] = words.max() + np.cumsum(words[used]) - words[used]
    columns = [np.zeros(int(words.max() + words[used].sum()), "<u8") for _ in bits]
    for key in used:
        for column, some in zip(columns, bits, strict=True):
            packed = np.packbits(some[first[key] : first[key + 1]], bitorder="little")
            column[offset[key] : offset[key] + words[key]].view(np.uint8)[: len(packed)] = packed
    blocks = np.add.reduceat(_bit_counts(columns[1]), np.arange(0, len(columns[1]), _BLOCK))
    before = (np.cumsum(blocks) - blocks).astype(np.uint32)
    all_reached, all_free = (column.astype(np.uint64) for column in columns)
    cells = PackedCells(offset, all_reached, all_free, before, codes, levels, _torso_bits(grid))
    for array in cells[:-1]:
        array.setflags(write=False)
    return cells


def key_sizes(grid: MapGrid) -> Integers:
    """(keys,) number of cells of every key, reached or not."""
    return np.tile(grid.orientations.count * (2 * grid.half) ** 2, grid.layers)


def dense(grid: MapGrid, cells: PackedCells, words: Words) -> Bools:
    """Unpack the bits of `reached` or `free`: (layers, orientations, x, y)."""
    bits = np.zeros(grid.size, np.bool_)
    first = 0
    for offset, size in zip(cells.offset.tolist(), key_sizes(grid).tolist(), strict=True):
        if offset:
            some = words[offset : offset + -(-size // 64)].astype("<u8").view(np.uint8)
            bits[first : first + size] = np.unpackbits(some, count=size, bitorder="little")
        first += size
    return bits.reshape(grid.shape)


def bits_of(cells: PackedCells, grid: MapGrid) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """The bits of `reached` and `free` for `join_cells`."""
    return _bytes(dense(grid, cells, cells.reached)), _bytes(dense(grid, cells, cells.free))


def _bytes(bits: Bools) -> NDArray[np.uint8]:
    return np.packbits(bits.reshape(-1), bitorder="little")


def _torso_bits(grid: MapGrid) -> int:
    return max(0, len(grid.torsos) - 1).bit_length()


_NIBBLES = np.array([bin(k).count("1") for k in range(256)], np.uint8)


def _bit_counts(words: Words) -> Integers:
    return _NIBBLES[words.view(np.uint8)].reshape(-1, 8).sum(axis=1, dtype=np.int64)


_ODD, _PAIRS = np.uint64(0x5555555555555555), np.uint64(0x3333333333333333)
_FOURS, _SUM = np.uint64(0x0F0F0F0F0F0F0F0F), np.uint64(0x0101010101010101)
_1, _2, _4, _6, _56, _63 = (np.uint64(k) for k in (1, 2, 4, 6, 56, 63))


@njit(cache=True, inline="always")
def _count_bits(word: np.uint64) -> np.uint64:
    """Number of bits that are set."""
    word = word - ((word >> _1) & _ODD)
    word = (word & _PAIRS) + ((word >> _2) & _PAIRS)
    return (((word + (word >> _4)) & _FOURS) * _SUM) >> _56


@njit(cache=True, inline="always")
def has_cell(words: Words, offset: int, local: int) -> bool:
    """Whether the bit of a key's cell is set, in `reached` or `free`."""
    place = np.uint64(local)
    return (words[np.uint64(offset) + (place >> _6)] >> (place & _63)) & _1 != 0


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def code_of(cells: PackedCells, key: int, local: int) -> int:
    """The code of a free cell."""
    place = np.uint64(local)
    word = np.uint64(cells.offset[key]) + (place >> _6)
    block = word >> _2
    count = np.uint64(cells.before[block])
    at = block << _2
    while at < word:
        count += _count_bits(cells.free[at])
        at += _1
    count += _count_bits(cells.free[word] & ((_1 << (place & _63)) - _1))
    return np.int64(cells.codes[count])  # type: ignore[return-value]  # an int to numba


@njit(cache=True, **WITHOUT_REFERENCE_COUNTS)
def mu_of(cells: PackedCells, key: int, local: int) -> float:
    """μ of a key's cell, 0 where it is not free."""
    mu = 0.0
    if has_cell(cells.free, cells.offset[key], local):
        mu = float(cells.levels[code_of(cells, key, local) >> cells.torso_bits])
    return mu

"""Tuples passed to kernels as pointers are read as the tuples themselves."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

from irm.compilation import njit
from irm.kernel_arguments import call_at, kernel_address, layout_of, leaf_kernel, packed, pointer_to, with_numbers


class Inner(NamedTuple):
    """Fields of several sizes: the address of each depends on those before it."""

    is_set: bool
    rows: NDArray[np.float64]
    count: int


class Outer(NamedTuple):
    """A tuple in a tuple."""

    mask: np.uint64
    first_only: bool
    inner: Inner
    scale: float
    numbers: NDArray[np.int64]


@leaf_kernel
def summary(outer: Outer) -> float:
    """A number that depends on all fields."""
    inner = outer.inner
    total = outer.scale * inner.rows[1, 2] + outer.numbers[2] + 1000.0 * inner.count
    if inner.is_set and not outer.first_only:
        total += float(outer.mask)
    return total


@njit
def summary_from_python(outer: Outer) -> float:
    return summary(outer)


@njit
def both_ways(outer: Outer) -> tuple[float, float]:
    return summary(outer), summary(pointer_to(outer))


@leaf_kernel
def fill(inner: Inner, value: float) -> None:
    inner.rows[0, 0] = value


@njit
def fill_through_pointer(outer: Outer, value: float) -> None:
    fill(pointer_to(outer).inner, value)


@njit
def read_another(outer: Outer) -> float:
    return pointer_to(outer).another


OUTER = Outer(np.uint64(1 << 40), False, Inner(True, np.arange(6.0).reshape(2, 3), 7), 0.5, np.arange(3))


@pytest.mark.parametrize("first_only", [False, True])
@pytest.mark.parametrize("is_set", [False, True])
def test_all_fields_are_those_of_the_tuple(is_set: bool, first_only: bool) -> None:
    by_value, by_address = both_ways(OUTER._replace(first_only=first_only, inner=OUTER.inner._replace(is_set=is_set)))
    assert by_address == by_value == 0.5 * 5.0 + 2 + 7000 + (1 << 40) * (is_set and not first_only)


def test_a_packed_tuple_is_read_as_the_tuple_also_with_packed_and_read_only_parts() -> None:
    fixed = OUTER.inner.rows.copy()
    fixed.setflags(write=False)
    for inner in (OUTER.inner, packed(OUTER.inner), OUTER.inner._replace(rows=fixed)):
        whole = packed(OUTER._replace(inner=inner))
        assert whole.scale == 0.5
        assert summary_from_python(whole) == both_ways(OUTER)[0]
    assert len(summary_from_python.signatures) == 1


class Numbered(NamedTuple):
    """Numbers of each type behind an array."""

    rows: NDArray[np.float64]
    mask: np.uint64
    is_set: bool
    count: int
    scale: float


@njit
def numbers_of(values: Numbered) -> tuple[float, float, float, float]:
    return float(values.mask), 1.0 if values.is_set else 0.0, float(values.count), values.scale + values.rows[1]


@pytest.mark.parametrize(
    "numbers",
    [{"mask": np.uint64(1 << 50)}, {"is_set": True, "scale": -2.5}, {"count": 12, "is_set": False}, {"scale": np.inf}],
)
def test_a_packed_tuple_with_other_numbers_is_one_packed_anew(numbers: dict[str, float]) -> None:
    before = Numbered(np.arange(2.0), np.uint64(3), False, 5, 0.25)
    first = packed(before)
    changed = with_numbers(first, **numbers)
    assert numbers_of(changed) == numbers_of(packed(before._replace(**numbers)))
    assert (changed.mask, changed.scale) == (before._replace(**numbers).mask, before._replace(**numbers).scale)
    assert numbers_of(first) == numbers_of(packed(before))
    assert len(numbers_of.signatures) == 1


def test_other_numbers_are_of_the_same_types_and_behind_all_else() -> None:
    with pytest.raises(TypeError, match="scale = 1 "):
        with_numbers(packed(Numbered(np.arange(2.0), np.uint64(3), False, 5, 0.25)), scale=1)
    with pytest.raises(TypeError, match="first_only = True"):
        with_numbers(packed(OUTER), first_only=True)


def test_a_field_that_kernels_could_not_read_is_refused() -> None:
    with pytest.raises(TypeError, match="C order"):
        packed(OUTER.inner._replace(rows=OUTER.inner.rows.T))
    with pytest.raises(TypeError, match="str"):
        packed(OUTER.inner._replace(count="seven"))


def test_arrays_are_shared() -> None:
    fill_through_pointer(OUTER, 9.0)
    assert OUTER.inner.rows[0, 0] == 9.0


def test_another_attribute_is_refused_when_a_kernel_is_compiled() -> None:
    with pytest.raises(numba.core.errors.TypingError, match="another"):
        read_another(OUTER)


@njit
def entry_of(outer: Outer, rows: NDArray[np.float64], row: int) -> int:
    """An integer that depends on all arguments; IndexError for a row that is not there."""
    if row >= rows.shape[0]:
        raise IndexError("no such row")
    return int(rows[row, 1]) + 10 * outer.inner.count + 100 * outer.numbers[2]


@njit
def entry_at(address: int, outer: Outer, rows: NDArray[np.float64], row: int) -> int:
    return call_at(address, (outer, rows, row))


ROWS = np.arange(6.0).reshape(3, 2)


def test_a_kernel_called_by_its_address_gets_what_one_called_by_its_name_gets() -> None:
    address = kernel_address(entry_of, layout_of(OUTER), ROWS, 0)
    for row in range(3):
        expected = entry_of(packed(OUTER), ROWS, row)
        assert entry_at(address, packed(OUTER), ROWS, row) == expected == 2 * row + 1 + 70 + 200
        assert entry_at(address, OUTER, ROWS, row) == expected  # a tuple itself is passed by its address


def test_the_error_of_a_kernel_called_by_its_address_arrives() -> None:
    with pytest.raises(IndexError, match="no such row"):
        entry_at(kernel_address(entry_of, layout_of(OUTER), ROWS, 0), packed(OUTER), ROWS, 3)


def test_an_array_that_is_not_in_c_order_is_refused_by_a_call_by_address() -> None:
    with pytest.raises(numba.TypingError, match="not in C order"):
        entry_at(0, packed(OUTER), np.asfortranarray(ROWS), 0)


def test_what_calls_a_kernel_by_its_address_does_not_contain_it() -> None:
    entry_at(kernel_address(entry_of, layout_of(OUTER), ROWS, 0), packed(OUTER), ROWS, 0)
    for compiled in entry_at.overloads.values():
        assert "entry_of" not in compiled.library.get_llvm_str()

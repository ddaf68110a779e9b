"""Kernels without reference counting, and named tuples passed to them by pointer, like a `const struct *` in C.

Numba passes a tuple as separate arguments, seven for each of its arrays: about 500 for a `CollisionQuery`. Copying them
takes a third of a collision check, and a kernel with so many arguments takes seconds to compile. A pointer is one
argument: the address of the tuple. It has the attributes of the tuple.

    outer(packed(query), X)                                  # `outer` reads query.robot.offsets and so on

    @njit(cache=True)
    def outer(query: CollisionQuery, X: Array) -> int:       # or called from Python with a small tuple itself
        return inner(pointer_to(query), X)

A pointer does not keep its tuple alive. A kernel may pass it on to kernels that it calls, but must not return it. The
argument of `pointer_to` must be an argument of the calling kernel.

Only this module uses internals of numba and llvmlite (`numba.core`, code generation) to generate code. Its tests fail
if a new version changes them.
"""

from __future__ import annotations

import hashlib
import struct
from functools import cache
from typing import Any, TypeVar, cast

import numpy as np
from llvmlite import ir
from numba import typeof
from numba.core import cgutils, types
from numba.core.datamodel import models, register_default
from numba.core.errors import TypingError
from numba.core.imputils import impl_ret_borrowed
from numba.core.registry import cpu_target
from numba.core.types.containers import BaseNamedTuple, BaseTuple
from numba.core.typing.templates import AttributeTemplate, Signature
from numba.extending import NativeValue, infer_getattr, intrinsic, lower_getattr_generic, unbox
from numba.np.numpy_support import from_dtype
from numpy.typing import NDArray

from irm.compilation import njit

Array = NDArray[np.float64]
leaf_kernel = njit(cache=True, _nrt=False)
"""`numba.njit` without reference counting. Neither the kernel nor its callees may allocate or return arrays.

Numba counts references, atomically, to every array taken out of a tuple. For the 50 arrays of a collision query this
takes longer than the check itself. Numba compiles its own inner loops in this way (`numba.misc.mergesort`), see
https://github.com/numba/numba/issues/2350. A kernel that allocates fails to compile ("NRT required but not enabled").
"""
inlined_kernel = njit(cache=True, _nrt=False, forceinline=True)
"""A `leaf_kernel` compiled into its callers, for a few lines in an inner loop. It multiplies code."""


@leaf_kernel
def copy_row(source: Array, target: Array) -> None:
    """`target[:] = source` for arrays (d,) of the same length.

    Numba would compile the assignment with an error message about shapes, half a second per kernel.
    """
    for i in range(target.shape[0]):
        target[i] = source[i]


@leaf_kernel
def copy_rows(source: Array, target: Array) -> None:
    """`target[:] = source` for arrays (k, d) of the same shape."""
    for row in range(target.shape[0]):
        for i in range(target.shape[1]):
            target[row, i] = source[row, i]


_BYTE = ir.IntType(8)


class StructPointer(types.Type):
    """The address of a named tuple, for numba.

    Attributes:
        target: numba's type of the tuple.
    """

    def __init__(self, target: BaseNamedTuple) -> None:
        """Choose a short name, because it becomes a part of the names of all compiled kernels."""
        self.target = target
        layout = hashlib.sha256(str(target).encode()).hexdigest()[:12]
        super().__init__(name=f"StructPointer({target.instance_class.__name__}, {layout})")

    @property
    def key(self) -> types.Type:
        """The value by which numba tells whether two pointers have the same type."""
        return self.target


@register_default(StructPointer)
class _StructPointerModel(models.PrimitiveModel):  # type: ignore[misc]  # numba has no type hints
    """Numba's model of the data: a pointer to bytes."""

    def __init__(self, manager: Any, pointer: StructPointer) -> None:
        super().__init__(manager, pointer, _BYTE.as_pointer())


@infer_getattr
class _StructPointerAttributes(AttributeTemplate):  # type: ignore[misc]  # numba has no type hints
    """Attributes of a pointer: those of the tuple, with pointers in place of inner tuples."""

    key = StructPointer

    def generic_resolve(self, pointer: StructPointer, name: str) -> types.Type | None:
        """The type of an attribute. None if the tuple has no such field."""
        if name not in pointer.target.fields:
            return None
        field = pointer.target[pointer.target.fields.index(name)]
        return StructPointer(field) if isinstance(field, BaseNamedTuple) else field


@lower_getattr_generic(StructPointer)
def _read_attribute(context: Any, builder: Any, pointer: StructPointer, address: Any, name: str) -> Any:
    """Emit code that reads an attribute: one load at the address of the tuple and the offset of the field."""
    index = pointer.target.fields.index(name)
    offset = ir.Constant(ir.IntType(64), _offset(context, pointer.target, index))
    place = builder.gep(address, [offset], inbounds=True)
    field = pointer.target[index]
    if isinstance(field, BaseNamedTuple):
        return place
    value = builder.load(builder.bitcast(place, context.get_value_type(field).as_pointer()))
    return impl_ret_borrowed(context, builder, field, value)


@cache
def _offset(context: Any, target: BaseNamedTuple, index: int) -> int:
    """[bytes] from the beginning of a tuple to a field."""
    layout = context.get_value_type(target)
    return int(layout.get_element_offset(context.target_data, index))


@intrinsic
def pointer_to(_typing_context: Any, value: types.Type) -> tuple[Signature, Any]:
    """Address of a named tuple, for kernels that this kernel calls. The module's text explains its use."""

    def store(context: Any, builder: Any, _signature: Signature, values: Any) -> Any:
        """Emit code that stores the tuple on the stack of the kernel that makes the pointer."""
        del context
        return builder.bitcast(cgutils.alloca_once_value(builder, values[0]), _BYTE.as_pointer())

    return StructPointer(value)(value), store


_WORD = 8
"""[bytes]"""
_SCALARS = {bool: types.boolean, int: types.int64, float: types.float64}
_SCALARS |= {np.uint64: types.uint64, np.int64: types.int64, np.float64: types.float64}
"""Types that numbers in a packed tuple may have."""
Layout = tuple[type, tuple[Any, ...]]
TupleT = TypeVar("TupleT", bound=tuple[Any, ...])


def packed(value: TupleT) -> TupleT:
    """Pack a named tuple, so that Python passes it to kernels by its address. Its fields stay readable in Python.

    Fields are arrays in C order, numbers, named tuples, and packed tuples. Kernels may write to all arrays, even to
    arrays that are read-only in Python, because one compiled kernel serves both.

    Raises:
        TypeError: a field is of another kind.
    """
    return cast(TupleT, _Packed(value))


class _Packed:
    """A named tuple and its memory as kernels read it. It keeps its fields alive."""

    value: Any
    words: NDArray[np.uint64]
    layout: Layout
    address: int

    def __init__(self, value: tuple[Any, ...]) -> None:
        parts, layout = _words_of(value)
        self.value, self.words, self.layout = value, np.concatenate(parts), layout
        self.address = int(self.words.__array_interface__["data"][0])
        self._numba_type_ = _pointer_type(layout)

    def __getattr__(self, name: str) -> Any:
        """A field of the tuple."""
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.value, name)

    def __getitem__(self, index: int) -> Any:
        """A field by its number, which also makes the fields iterable."""
        return self.value[index]


def with_numbers(value: TupleT, **numbers: float | np.uint64) -> TupleT:
    """Copy a packed tuple with other numbers, of the same types, in some of its last fields. Much faster than
    `packed`."""
    before, copy = cast(_Packed, value), _Packed.__new__(_Packed)
    copy.value, copy.words, copy.layout = before.value._replace(**numbers), before.words.copy(), before.layout
    copy.address, copy._numba_type_ = int(copy.words.__array_interface__["data"][0]), before._numba_type_
    last = _last_numbers(before.layout)
    for name, number in numbers.items():
        place, kind = last.get(name, (0, None))
        if type(number) is not kind:
            raise TypeError(f"{name} = {number!r} is not a {kind} among the last fields")
        words = copy.words.view(np.float64) if kind is float else copy.words
        words[place] = number
    return cast(TupleT, copy)


@cache
def _last_numbers(layout: Layout) -> dict[str, tuple[int, type]]:
    """Place, from the end of the memory, and type of each of the last fields that are numbers, by name."""
    named, kinds = list(zip(layout[0]._fields, layout[1], strict=True)), {}  # type: ignore[attr-defined]  # a named tuple
    for place, (name, kind) in enumerate(reversed(named), 1):
        if not isinstance(kind, type):
            break
        kinds[name] = -place, kind
    return kinds


def _words_of(value: tuple[Any, ...]) -> tuple[list[NDArray[np.uint64]], Layout]:
    """Memory of a tuple in pieces, and its layout: the tuple's class, and the layout or type of each field."""
    parts: list[NDArray[np.uint64]] = []
    words: list[int] = []
    layout: list[Any] = []
    for field in value:
        if isinstance(field, np.ndarray):
            if not field.flags.c_contiguous:
                raise TypeError("an array of a packed tuple is not in C order")
            # The two objects for numba's reference counts stay empty, because the packed tuple keeps the array alive.
            address = field.__array_interface__["data"][0]
            words += (0, 0, field.size, field.itemsize, address, *field.shape, *field.strides)
            layout.append((field.dtype.char, field.ndim))
        elif isinstance(field, _Packed | tuple):
            inner, of_inner = ([field.words], field.layout) if isinstance(field, _Packed) else _words_of(field)
            parts += (np.array(words, np.uint64), *inner)
            words = []
            layout.append(of_inner)
        elif type(field) in _SCALARS:
            is_float = isinstance(field, float)
            words.append(struct.unpack("Q", struct.pack("d", field))[0] if is_float else int(field) & (1 << 64) - 1)
            layout.append(type(field))
        else:
            raise TypeError(f"a packed tuple cannot hold a {type(field).__name__}")
    return [*parts, np.array(words, np.uint64)], (type(value), tuple(layout))


@cache
def _pointer_type(layout: Layout) -> StructPointer:
    """Numba's type of a packed tuple."""
    target, words = _type_of(layout)
    context = cpu_target.target_context
    # Numbers smaller than a word that follow each other would share one.
    assert context.get_abi_sizeof(context.get_value_type(target)) == _WORD * words
    return StructPointer(target)


def _type_of(layout: Layout) -> tuple[BaseNamedTuple, int]:
    """Numba's type of a tuple, and its size in words."""
    named, total = layout[0], 0
    fields: list[types.Type] = []
    found: types.Type
    for one in layout[1]:
        if isinstance(one, type):
            found, words = _SCALARS[one], 1
        elif isinstance(one[0], str):
            found, words = types.Array(from_dtype(np.dtype(one[0])), one[1], "C"), 5 + 2 * one[1]
        else:
            found, words = _type_of(one)
        fields.append(found)
        total += words
    return BaseTuple.from_types(fields, named), total


def layout_of(value: tuple[Any, ...]) -> Layout:
    """Layout that determines a named tuple's type for kernels, packed or not. It is hashed in microseconds, unlike the
    type."""
    return value.layout if isinstance(value, _Packed) else _words_of(value)[1]


def kernel_address(kernel: Any, layout: Layout, *others: Any) -> int:
    """Address of a kernel for `call_at`, compiled for a packed tuple of that layout and for arguments like the others.

    It is valid in this process alone.
    """
    signature = (_pointer_type(layout), *(typeof(argument) for argument in others))
    kernel.compile(signature)
    compiled = kernel.overloads[signature]
    return int(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))


@intrinsic
def call_at(_typing_context: Any, _at: types.Type, arguments: BaseTuple) -> tuple[Signature, Any]:
    """The integer that the kernel at an address returns: `call_at(address, (query, X))`.

    A kernel that calls another kernel by name contains a second compiled copy of it and of its callees. This call
    avoids the copy. The arguments must have the types given to `kernel_address`. A named tuple is passed by its
    address.
    """
    for field in arguments:
        if isinstance(field, types.Array) and field.layout != "C":
            raise TypingError(f"an array that a kernel is called with by its address is not in C order: {field}")
    passed = [StructPointer(field) if isinstance(field, BaseNamedTuple) else field for field in arguments]

    def call(context: Any, builder: Any, _signature: Signature, values: Any) -> Any:
        """Emit the call as numba does for a compiled function, and pass on its exception."""
        given = cgutils.unpack_tuple(builder, values[1], len(passed))
        for index, field in enumerate(arguments):
            if isinstance(field, BaseNamedTuple):
                given[index] = builder.bitcast(cgutils.alloca_once_value(builder, given[index]), _BYTE.as_pointer())
        function = context.call_conv.get_function_type(types.int64, passed)
        pointer = builder.inttoptr(values[0], function.as_pointer())
        status, result = context.call_conv.call_function(builder, pointer, types.int64, passed, given)
        with cgutils.if_unlikely(builder, status.is_error):
            context.call_conv.return_status_propagate(builder, status)
        return result

    return types.int64(types.int64, arguments), call


@unbox(StructPointer)
def _address_of(_pointer: StructPointer, packed: Any, c: Any) -> NativeValue:
    """Emit code that reads the address of a packed tuple."""
    number = c.pyapi.object_getattr_string(packed, "address")
    address = c.builder.inttoptr(c.pyapi.number_as_ssize_t(number), _BYTE.as_pointer())
    c.pyapi.decref(number)
    return NativeValue(address)

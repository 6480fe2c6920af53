"""Formulas over the arrays of a file, such as ``= 2 * raw[0:2, :, :320] - 1``, as text of a sidecar.

A formula begins with ``=``. It has numbers, ``pi``, names of arrays, slices, ``+ - * / // %``, the functions
of `_FUNCTIONS` and ``reshape(raw, 4, 4)``; a name with other signs stands in quotes. It is no program: every
part that is not listed here is refused before anything is computed, and each result must fit into the memory.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

import numpy as np

from disk.machine_memory import memory_shortage
from itof.arrays import Numbers

_SIGN: Final = "="
_OPERATIONS: Final[dict[type[ast.operator], Callable[[Any, Any], Any]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: np.divide,
    ast.FloorDiv: np.floor_divide,
    ast.Mod: np.mod,
}
_FUNCTIONS: Final[dict[str, Callable[[Any], Any]]] = {
    "abs": np.abs,
    "sqrt": np.sqrt,
    "exp": np.exp,
    "cos": np.cos,
    "sin": np.sin,
}
_RESHAPE: Final = "reshape"
_LONGEST: Final = 500  # characters, which nest less deep than Python's calls may
_COPIES = 3  # of an array: a result and what it is made of


def names_in(text: str) -> tuple[str, ...]:
    """Names of the arrays that a name or formula needs, as often as it needs them.

    Raises
    ------
    ValueError : the formula has a part that is not allowed.
    """
    if not text.startswith(_SIGN):
        return (text,)
    found = tuple(_names(_parsed(text), text))
    if not found:
        raise ValueError(f"the formula {text!r} names no array")
    return found


def value_of(text: str, arrays: Mapping[str, Numbers]) -> Numbers:
    """The array that a name or formula means; slices are views, all else is float64 or complex128.

    Raises
    ------
    KeyError : there is no array of a name.
    ValueError : the formula does not fit the arrays, or a result does not fit into the memory.
    """
    if not text.startswith(_SIGN):
        return arrays[text]
    try:
        with np.errstate(all="ignore"):  # what is not finite is a dead pixel
            return np.asarray(_value(_parsed(text), arrays))
    except (ValueError, IndexError, TypeError, ArithmeticError) as error:
        shapes = ", ".join(f"{name} {arrays[name].shape}" for name in dict.fromkeys(names_in(text)))
        raise ValueError(f"the formula {text!r} does not fit {shapes}: {error}") from None


def _parsed(text: str) -> ast.expr:
    if len(text) > _LONGEST:
        raise ValueError(f"a formula has {len(text)} characters, the most are {_LONGEST}: {text[:40]!r}...")
    try:
        return ast.parse(text.removeprefix(_SIGN).strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ValueError(f"{text!r} is no formula like '= 2 * raw[0] - 1'") from None


def _names(node: ast.expr, text: str) -> Iterator[str]:
    """The arrays that a part of a formula names; refuses what a formula may not have."""
    name = _name(node)
    if name is not None:
        if not name.isprintable():
            raise ValueError(f"the formula {text!r} names an array with signs that cannot be printed")
        yield name
    elif isinstance(node, ast.BinOp) and type(node.op) in _OPERATIONS:
        yield from _names(node.left, text)
        yield from _names(node.right, text)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        yield from _names(node.operand, text)
    elif isinstance(node, ast.Subscript):
        _place(node.slice, text)
        yield from _names(node.value, text)
    elif isinstance(node, ast.Call) and _is_function(node):
        _ = [_place(side, text) for side in node.args[1:]]
        yield from _names(node.args[0], text)
    elif not _is_number(node):
        raise ValueError(f"the formula {text!r} has a part that is not allowed: {ast.unparse(node)}")


def _name(node: ast.expr) -> str | None:
    """The array that a node names: ``raw``, ``struct.field``, or a text in quotes."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.Attribute):
        inner = _name(node.value)
        return None if inner is None else f"{inner}.{node.attr}"
    return node.id if isinstance(node, ast.Name) and node.id != "pi" else None


def _is_number(node: ast.expr) -> bool:
    return (isinstance(node, ast.Constant) and type(node.value) in (int, float, complex)) or (
        isinstance(node, ast.Name) and node.id == "pi"
    )


def _is_function(node: ast.Call) -> bool:
    name = node.func.id if isinstance(node.func, ast.Name) else ""
    count = len(node.args)
    return not node.keywords and (count == 1 if name in _FUNCTIONS else name == _RESHAPE and count > 1)


def _place(node: ast.expr, text: str) -> Any:
    """A slice, a whole number, an ellipsis, or several of them; lists of places would make arrays larger."""
    if isinstance(node, ast.Tuple) and not any(isinstance(each, ast.Tuple) for each in node.elts):
        return tuple(_place(each, text) for each in node.elts)
    if isinstance(node, ast.Slice):
        ends = (node.lower, node.upper, node.step)
        return slice(*(None if end is None else _place(end, text) for end in ends))
    sign = -1 if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub) else 1
    value = node.operand if isinstance(node, ast.UnaryOp) else node
    if isinstance(value, ast.Constant) and type(value.value) is int:
        return sign * value.value
    if isinstance(node, ast.Constant) and node.value is ...:
        return node.value
    raise ValueError(f"the formula {text!r} has no place of an array in brackets: {ast.unparse(node)}")


def _value(node: ast.expr, arrays: Mapping[str, Numbers]) -> Any:
    name = _name(node)
    if name is not None:
        return arrays[name]
    if isinstance(node, ast.BinOp):
        one, other = _number(_value(node.left, arrays)), _number(_value(node.right, arrays))
        _refuse_large(np.broadcast_shapes(one.shape, other.shape))
        return _OPERATIONS[type(node.op)](one, other)
    if isinstance(node, ast.UnaryOp):
        return -_number(_value(node.operand, arrays))
    if isinstance(node, ast.Subscript):
        return _value(node.value, arrays)[_place(node.slice, "")]
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        inner = _value(node.args[0], arrays)
        if node.func.id == _RESHAPE:
            return np.reshape(inner, [_place(side, "") for side in node.args[1:]])
        return _FUNCTIONS[node.func.id](_number(inner))
    return node.value if isinstance(node, ast.Constant) else math.pi


def _number(value: Any) -> Numbers:
    """A value with the precision of all results: whole numbers of a camera would overflow."""
    values = np.asarray(value)
    _refuse_large(values.shape)
    return values.astype(np.complex128 if values.dtype.kind == "c" else np.float64)


def _refuse_large(shape: tuple[int, ...]) -> None:
    count = math.prod(shape) * np.dtype(np.complex128).itemsize
    if shortage := memory_shortage(count, copies=_COPIES):
        raise ValueError(f"a result of shape {shape} {shortage}")

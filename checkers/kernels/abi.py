"""How a compiled backend is called: one C signature, so that every loop is compiled once for all backends.

A backend's kernel is a plain C function
    value = f(m1, m2, s11, s12, s22, det, moments, order, options, out)
on the whitened Gaussian or moments of one agent mode (ego ellipsoid = unit disc about the origin):
    m1, m2          mean
    s11, s12, s22   covariance
    det             its determinant, which s11 s22 − s12² loses to cancellation in elongated covariances
    moments         (order+1)² central moments, row-major, or unread when order = 0 (then the mode is Gaussian)
    options         the backend's own numbers
    out             ROOM numbers: out[0] absolute error of the value, out[1] lower bound, both preset to NaN;
                    the rest is room to work in, since allocating costs as much as a bound
It travels as an address, so compiled loops are cached on disk whichever backends exist.
"""

from collections.abc import Callable
from typing import NamedTuple

import numba as nb
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

ROOM = 192
_DOUBLES = types.CPointer(types.float64)
SIGNATURE = types.float64(
    *[types.float64] * 6,
    _DOUBLES,
    types.int64,
    _DOUBLES,
    _DOUBLES,
)


class Kernel(NamedTuple):
    """A compiled function, kept alive by whoever holds it, and its address."""

    function: object
    address: int


def kernel(function: Callable[..., float]) -> Kernel:
    """Compile a backend's scalar function to the common signature; `.address` is what loops take.

    Under numpy's error model a division by zero gives NaN, which callers refuse; an exception would be swallowed at the
    C boundary and read as the value 0.
    """
    return c_function(SIGNATURE, function)


def c_function(signature: object, function: Callable[..., object]) -> Kernel:
    """Compile to a plain C function of that signature, kept on disk unless it was typed at a prompt."""
    in_a_file = not function.__code__.co_filename.startswith("<")
    compiled = nb.cfunc(signature, cache=in_a_file, error_model="numpy")(function)
    return Kernel(compiled, int(compiled.address))


@intrinsic
def call_kernel(typingctx, address, m1, m2, s11, s12, s22, det, moments, order, options, out):
    """Call the kernel at `address`; the last arrays are given by their data addresses."""
    sig = types.float64(types.int64, *[types.float64] * 6, types.uintp, types.int64, types.uintp, types.uintp)

    def codegen(context, builder, signature, args):
        double, word = ir.DoubleType(), ir.IntType(64)
        pointer = double.as_pointer()
        function_type = ir.FunctionType(double, [double] * 6 + [pointer, word, pointer, pointer])
        function = builder.inttoptr(args[0], function_type.as_pointer())
        call = list(args[1:])
        for position in (6, 8, 9):
            call[position] = builder.inttoptr(call[position], pointer)
        return builder.call(function, call)

    return sig, codegen

"""How a vehicle's motion is called: one C signature, so that every loop is compiled once for all vehicles.

A vehicle's kernel is a plain C function
    driven = f(node, u1, u2, u3, steps, dt, limits, lanes, lane_count, out)
that drives from a node of a search for `steps` steps of `dt` seconds:
    node            NODE numbers: x, y, heading, speed, steering, step
    u1, u2, u3      controls in [−1, 1]; the kernel maps them so that plain motions are likely and every one possible
    limits          LIMITS numbers of the vehicle, in its own order
    lanes           (lane_count, 6) lane pieces, see `kernels.car.lane_frame`
    out             (steps, STATE), filled: x, y, heading, speed, steering at the end of every step
    driven          the number of steps at whose end and within which every limit of the vehicle holds
It travels as an address, as the kernels of the checkers do (`checkers.kernels.abi`).
"""

from collections.abc import Callable

import numba as nb
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from checkers.kernels.abi import Kernel, c_function

STATE, NODE, LIMITS = 5, 6, 16
_DOUBLES = types.CPointer(types.float64)
SIGNATURE = types.int64(
    _DOUBLES,
    *[types.float64] * 3,
    types.int64,
    types.float64,
    _DOUBLES,
    _DOUBLES,
    types.int64,
    _DOUBLES,
)


def steer_kernel(function: Callable[..., int]) -> Kernel:
    """Compile a vehicle's function to the common signature; `.address` is what loops take."""
    return c_function(SIGNATURE, function)


@nb.njit(inline="always", error_model="numpy")
def arrays(node, limits, lanes, lane_count, out, steps):
    """What a kernel is given, as arrays: node, limits, lanes, out."""
    return (
        nb.carray(node, (NODE,)),
        nb.carray(limits, (LIMITS,)),
        nb.carray(lanes, (lane_count, 6)),
        nb.carray(out, (steps, STATE)),
    )


@intrinsic
def _call(typingctx, address, node, u1, u2, u3, steps, dt, limits, lanes, lane_count, out):
    """Call the kernel at `address`; arrays are given by their data addresses."""
    word, number = types.uintp, types.float64
    sig = types.int64(types.int64, word, number, number, number, types.int64, number, word, word, types.int64, word)

    def codegen(context, builder, signature, args):
        double, integer = ir.DoubleType(), ir.IntType(64)
        pointer = double.as_pointer()
        takes = [pointer, double, double, double, integer, double, pointer, pointer, integer, pointer]
        function = builder.inttoptr(args[0], ir.FunctionType(integer, takes).as_pointer())
        given = list(args[1:])
        for position in (0, 6, 7, 9):
            given[position] = builder.inttoptr(given[position], pointer)
        return builder.call(function, given)

    return sig, codegen


@nb.njit(cache=True, error_model="numpy")
def steer(address, node, u1, u2, u3, steps, dt, limits, lanes, out):
    """Drive from `node` by the kernel at `address`, see above; returns the number of steps within the limits."""
    return _call(
        address,
        node.ctypes.data,
        u1,
        u2,
        u3,
        steps,
        dt,
        limits.ctypes.data,
        lanes.ctypes.data,
        lanes.shape[0],
        out.ctypes.data,
    )

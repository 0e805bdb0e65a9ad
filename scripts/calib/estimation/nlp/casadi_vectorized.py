"""Run CasADi functions on whole arrays: NumPy executes their instructions one after the other.

CasADi's own map interprets every instruction anew for every measurement, and takes about thirty
times as long.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

NUMPY_BY_CASADI_OP: dict[int, Callable] = {
    ca.OP_ADD: np.add,
    ca.OP_SUB: np.subtract,
    ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide,
    ca.OP_NEG: np.negative,
    ca.OP_EXP: np.exp,
    ca.OP_LOG: np.log,
    ca.OP_POW: np.power,
    ca.OP_CONSTPOW: np.power,
    ca.OP_SQRT: np.sqrt,
    ca.OP_SQ: np.square,
    ca.OP_TWICE: lambda a: 2 * a,
    ca.OP_SIN: np.sin,
    ca.OP_COS: np.cos,
    ca.OP_TAN: np.tan,
    ca.OP_ASIN: np.arcsin,
    ca.OP_ACOS: np.arccos,
    ca.OP_ATAN: np.arctan,
    ca.OP_ATAN2: np.arctan2,
    ca.OP_LT: np.less,
    ca.OP_LE: np.less_equal,
    ca.OP_EQ: np.equal,
    ca.OP_NE: np.not_equal,
    ca.OP_NOT: np.logical_not,
    ca.OP_AND: np.logical_and,
    ca.OP_OR: np.logical_or,
    ca.OP_FABS: np.abs,
    ca.OP_SIGN: np.sign,
    ca.OP_FMIN: np.minimum,
    ca.OP_FMAX: np.maximum,
    ca.OP_INV: np.reciprocal,
    ca.OP_IF_ELSE_ZERO: lambda condition, a: np.where(condition, a, 0.0),
    ca.OP_ASSIGN: lambda a: a,
}


# A column of inputs or outputs: one entry per element of the function, a number or an array (n,).
Elements = Sequence[Any]
VectorizedFunction = Callable[..., list[list[Any]]]


class Instruction(NamedTuple):
    """One instruction: what to do, where the result goes, and where the operands are.

    action: "input", "output", "constant" or a NumPy function; constant: its value.
    """

    action: str | Callable
    result: list[int]
    operands: list[int]
    constant: float = 0.0


def vectorize_casadi_function(function: ca.Function) -> VectorizedFunction:
    """Return f(*inputs) -> outputs for an SX function; each of them is Elements, column by column.

    Raises ValueError for an instruction that NUMPY_BY_CASADI_OP does not have.
    """
    program = [_parse_instruction(function, k) for k in range(function.n_instructions())]
    n_work = function.sz_w()
    output_sizes = [function.nnz_out(i) for i in range(function.n_out())]

    def run(*inputs: Elements) -> list[list[Any]]:
        work: list[Any] = [0.0] * n_work
        out: list[list[Any]] = [[0.0] * n for n in output_sizes]
        with np.errstate(divide="ignore", invalid="ignore"):
            for action, result, operands, constant in program:
                if action == "input":
                    work[result[0]] = inputs[operands[0]][operands[1]]
                elif action == "output":
                    out[result[0]][result[1]] = work[operands[0]]
                elif action == "constant":
                    work[result[0]] = constant
                elif callable(action):
                    work[result[0]] = action(*[work[i] for i in operands])
        return out

    return run


def _parse_instruction(function: ca.Function, k: int) -> Instruction:
    """Read the k-th instruction of a function."""
    op = function.instruction_id(k)
    result, operands = function.instruction_output(k), function.instruction_input(k)
    if op == ca.OP_INPUT:
        return Instruction("input", result, operands)
    if op == ca.OP_OUTPUT:
        return Instruction("output", result, operands)
    if op == ca.OP_CONST:
        value = float(function.instruction_constant(k))
        return Instruction("constant", result, operands, value)
    if op not in NUMPY_BY_CASADI_OP:
        raise ValueError(
            f"CasADi instruction {op} has no NumPy function; add it to NUMPY_BY_CASADI_OP in "
            "casadi_vectorized.py"
        )
    return Instruction(NUMPY_BY_CASADI_OP[op], result, operands)

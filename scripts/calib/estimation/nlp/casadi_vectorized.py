"""CasADi functions over whole arrays: their instructions, one after the other, by NumPy.

CasADi's own map interprets every instruction again for every measurement, which costs it some
thirty times as much.
"""

import casadi as ca
import numpy as np

NUMPY_BY_CASADI_OP = {
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


def vectorize_casadi_function(function):
    """f(*inputs) -> list of outputs, each a list of arrays, of an SX Function.

    An input is a sequence of the function's input elements, column by column, each a number or an
    array (n,); an output lists its elements likewise, each a number or an array (n,). Raises
    ValueError for an instruction that UFUNCS does not know.
    """
    program = [_parse_instruction(function, k) for k in range(function.n_instructions())]
    width = function.sz_w()
    counts = [function.nnz_out(i) for i in range(function.n_out())]

    def run(*inputs):
        work, out = [0.0] * width, [[0.0] * n for n in counts]
        with np.errstate(divide="ignore", invalid="ignore"):
            for ufunc, to, source in program:
                if ufunc == "input":
                    work[to[0]] = inputs[source[0]][source[1]]
                elif ufunc == "output":
                    out[to[0]][to[1]] = work[source[0]]
                elif ufunc == "constant":
                    work[to[0]] = source
                else:
                    work[to[0]] = ufunc(*[work[i] for i in source])
        return out

    return run


def _parse_instruction(function, k):
    """(what to do, where to, where from) of the k-th instruction."""
    op = function.instruction_id(k)
    to, source = function.instruction_output(k), function.instruction_input(k)
    if op == ca.OP_INPUT:
        return "input", to, source
    if op == ca.OP_OUTPUT:
        return "output", to, source
    if op == ca.OP_CONST:
        return "constant", to, float(function.instruction_constant(k))
    if op not in NUMPY_BY_CASADI_OP:
        raise ValueError(
            f"CasADi instruction {op} has no NumPy function in casadi_vectorized.UFUNCS"
        )
    return NUMPY_BY_CASADI_OP[op], to, source

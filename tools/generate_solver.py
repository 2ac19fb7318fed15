"""Generator of mpc.c, the car's solver in C: `python -m tools.generate_solver`.

With `--check`, the generated text is compared with mpc.c, and nothing is written. The text consists of the algorithm in
solver.c.in and of functions that CasADi derives from the model and from the steps of the Riccati recursion: sparse
straight-line code without common subexpressions.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from targets.car.control.solver.model import INPUTS, STATES, STEP, STEPS, step

HERE = Path(__file__).parents[1] / "targets" / "car" / "control" / "solver"
TEMPLATE, OUTPUT = HERE / "solver.c.in", HERE / "mpc.c"
WIDTH = 116  # columns


def kernels() -> list[Any]:
    """Return the CasADi functions that the solver calls, in their order in mpc.c."""
    import casadi as ca

    z, u, wheelbase = ca.SX.sym("z", STATES), ca.SX.sym("u", INPUTS), ca.SX.sym("wheelbase")
    following = step(z, u, wheelbase)
    a, b = ca.jacobian(following, z), ca.jacobian(following, u)
    a_varying, b_varying = _varying(a), _varying(b)
    # Jacobians for the recursion: constant entries stay constants, the others become arguments.
    a_given, b_given = ca.SX.sym("a", a_varying.numel()), ca.SX.sym("b", b_varying.numel())
    a_in, b_in = _filled(a, a_given), _filled(b, b_given)

    p, q, r = ca.SX.sym("P", ca.Sparsity.upper(STATES)), ca.SX.sym("q", STATES), ca.SX.sym("r", INPUTS)
    cost = ca.triu2symm(p) + ca.diag(q)
    h = b_in.T @ cost @ b_in + ca.diag(r)
    s = b_in.T @ cost @ a_in
    determinant = h[0, 0] * h[1, 1] - h[0, 1] * h[0, 1]
    inverse = ca.vertcat(ca.horzcat(h[1, 1], -h[0, 1]), ca.horzcat(-h[0, 1], h[0, 0])) / determinant
    gain = -inverse @ s
    before = ca.triu(a_in.T @ cost @ a_in + s.T @ gain)

    vector, g, e = ca.SX.sym("p", STATES), ca.SX.sym("g", STATES), ca.SX.sym("e", INPUTS)
    k, hi = ca.SX.sym("K", INPUTS, STATES), ca.SX.sym("H", 3)
    slope = vector + g
    wanted = b_in.T @ slope + e
    push = -ca.vertcat(hi[0] * wanted[0] + hi[1] * wanted[1], hi[1] * wanted[0] + hi[2] * wanted[1])

    d, c = ca.SX.sym("d", STATES), ca.SX.sym("c", INPUTS)
    change = k @ d + c
    return [
        ca.Function("advance", [z, u, wheelbase], [following], ["z", "u", "l"], ["next"], {"cse": True}),
        ca.Function("linearise", [z, u, wheelbase], [a_varying, b_varying], ["z", "u", "l"], ["A", "B"], {"cse": True}),
        ca.Function(
            "factorise", [p, q, r, a_given, b_given],
            [_upper(before), ca.vec(gain), ca.vertcat(inverse[0, 0], inverse[0, 1], inverse[1, 1])],
            ["P", "q", "r", "A", "B"], ["P0", "K", "H"], {"cse": True},
        ),
        ca.Function(
            "descend", [vector, g, e, a_given, b_given, k, hi], [a_in.T @ slope + k.T @ wanted, push],
            ["p", "g", "e", "A", "B", "K", "H"], ["p0", "k"], {"cse": True},
        ),
        ca.Function(
            "ascend", [d, k, c, a_given, b_given], [change, a_in @ d + b_in @ change],
            ["d", "K", "k", "A", "B"], ["change", "d1"], {"cse": True},
        ),
    ]  # fmt: skip


def _varying(matrix: Any) -> Any:
    """Return the entries of a sparse matrix that are not constant, as a column."""
    import casadi as ca

    return ca.vertcat(*(e for e in matrix.nonzeros() if not e.is_constant()))


def _filled(matrix: Any, values: Any) -> Any:
    """Return the matrix with `values` in place of the entries that are not constant."""
    import casadi as ca

    left = iter(range(values.numel()))
    entries = [e if e.is_constant() else values[next(left)] for e in matrix.nonzeros()]
    return ca.SX(matrix.sparsity(), ca.vertcat(*entries))


def _upper(matrix: Any) -> Any:
    import casadi as ca

    return ca.vertcat(*ca.densify(matrix)[ca.Sparsity.upper(STATES)].nonzeros())


def as_c(function: Any) -> str:
    """Return a CasADi function of scalars as a C function: arguments, then results, all arrays of double."""
    import casadi as ca

    binary = {ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*", ca.OP_DIV: "/"}
    unary = {ca.OP_NEG: "-{}", ca.OP_SIN: "sin({})", ca.OP_COS: "cos({})", ca.OP_TAN: "tan({})",
             ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "2 * {}", ca.OP_INV: "1 / {}"}  # fmt: skip
    names = (
        [function.name_in(i) for i in range(function.n_in())],
        [function.name_out(i) for i in range(function.n_out())],
    )
    lines, size = [], 0
    for i in range(function.n_instructions()):
        operation, source, target = (
            function.instruction_id(i), function.instruction_input(i), function.instruction_output(i)
        )  # fmt: skip
        if operation == ca.OP_OUTPUT:
            lines.append(f"{names[1][target[0]]}[{target[1]}] = w{source[0]};")
            continue
        size = max(size, target[0] + 1)
        if operation == ca.OP_INPUT:
            value = f"{names[0][source[0]]}[{source[1]}]"
        elif operation == ca.OP_CONST:
            value = repr(function.instruction_constant(i))
        elif operation in binary:
            value = f"w{source[0]} {binary[operation]} w{source[1]}"
        else:
            value = unary[operation].format(f"w{source[0]}")
        lines.append(f"w{target[0]} = {value};")
    arguments = [f"const double *{n}" for n in names[0]] + [f"double *restrict {n}" for n in names[1]]
    head = f"static void {function.name()}({', '.join(arguments)})\n{{\n"
    return (
        head + _filled_lines("double " + ", ".join(f"w{i}" for i in range(size)) + ";") + _filled_lines(*lines) + "}\n"
    )


def _filled_lines(*statements: str) -> str:
    """Return the text of C statements, wrapped at WIDTH columns."""
    text, line = "", "   "
    for word in " ".join(statements).split(" "):
        if len(line) + 1 + len(word) > WIDTH:
            text, line = f"{text}{line}\n", "   "
        line += f" {word}"
    return f"{text}{line}\n"


def generate() -> str:
    """Return the text of mpc.c."""
    code = "\n".join(as_c(f) for f in kernels())
    sizes = f"#define STEPS {STEPS}\n#define STEP {STEP}\n#define STATES {STATES}\n#define INPUTS {INPUTS}\n"
    note = "/* Generated by tools/generate_solver.py from solver.c.in; do not edit. */\n"
    return note + TEMPLATE.read_text(encoding="utf-8").replace("@KERNELS@\n", f"{sizes}\n{code}")


def main() -> int:
    fresh = generate()
    if "--check" in sys.argv[1:]:
        if OUTPUT.read_text(encoding="utf-8") != fresh:
            print(f"{OUTPUT} is out of date; run `make generated`", file=sys.stderr)
            return 1
        return 0
    OUTPUT.write_text(fresh, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""The exact derivative of the axis, written from its own text (forward mode, source to source).

Beside every scalar `a` stands `d_a`, its derivatives with respect to up to sixteen parameters at once
(`twin.codegen.simd_derivatives`); `xd` holds those of the states, `pd` those of the parameters: a one where the
parameter is the column, zero elsewhere. SymPy differentiates laws and assignments. Branches and event times are
followed as computed, so the derivative is that of the computed trajectory, not of an approximation.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable

import sympy

from twin.codegen.python import Numbering, code, laws_by_slot, module, resolve
from twin.effects.effect import SLOTS
from twin.model.equations import argument, trace
from twin.model.stepper import EVERYTHING

_MATH = {"sqrt": sympy.sqrt, "exp": sympy.exp}
SHARED = ("x", "p", "k")

#: Arguments of laws that never depend on a parameter.
FIXED_ARGUMENTS = frozenset({"direction", "moment", "payload"})
#: Parameters that are never fitted: the text has no column for them.
NEVER = frozenset(p.name for p in EVERYTHING.parameters if not p.estimated)


def _symbolic(node: ast.expr) -> sympy.Expr:
    """A stepper expression as SymPy; names and subscripts become symbols named by their text."""
    match node:
        case ast.Constant(value):
            return sympy.Float(value) if isinstance(value, float) else sympy.Integer(value)
        case ast.Name() | ast.Subscript():
            return sympy.Symbol(ast.unparse(node), real=True)
        case ast.UnaryOp(ast.USub(), operand):
            return -_symbolic(operand)
        case ast.BinOp(left, operator, right):
            a, b = _symbolic(left), _symbolic(right)
            match operator:
                case ast.Add():
                    return a + b
                case ast.Sub():
                    return a - b
                case ast.Mult():
                    return a * b
                case ast.Div():
                    return a / b
                case ast.Pow():
                    return a**b
        case ast.Call(ast.Name(name), [inner]) if name in _MATH:
            return _MATH[name](_symbolic(inner))
    raise ValueError(f"the stepper's language has no {ast.unparse(node)!r}")


def _sum(terms: Iterable[tuple[sympy.Expr, str]]) -> str:
    """Text of the sum of partial * derivative."""
    text = ""
    for partial, derivative in terms:
        if partial == 0:
            continue
        if partial == 1:
            text += f" + {derivative}"
        elif partial == -1:
            text += f" - {derivative}"
        else:
            text += f" + ({code(partial)}) * {derivative}"
    return text.removeprefix(" + ").strip() or "zero()"


class FunctionDerivative:
    """Writes the derivative of one stepper function."""

    def __init__(self, tree: ast.FunctionDef, formals: dict[str, tuple[str, ...]]) -> None:
        self.tree = tree
        self.formals = formals
        self.discrete = self._discrete()
        self.lines: list[str] = []

    def _discrete(self) -> set[str]:
        """Names that only ever hold whole numbers: flags, not quantities."""
        values: dict[str, bool] = {}
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                value = node.value.operand if isinstance(node.value, ast.UnaryOp) else node.value
                whole = isinstance(value, ast.Constant) and isinstance(value.value, int)
                name = node.targets[0].id
                values[name] = values.get(name, True) and whole
        return {name for name, whole in values.items() if whole}

    def _name(self, text: str) -> str | None:
        """The derivative of a symbol, or None where it is zero."""
        if text.startswith("x["):
            return f"row(xd, {text[2:-1]})"
        if text.startswith("p["):
            return f"row(pd, {text[2:-1]})"
        if text.startswith("k[") or text in self.discrete:
            return None
        return f"d_{text}"

    def _derivative(self, value: ast.expr) -> str:
        """Text of the derivative of an expression."""
        match value:
            case ast.BinOp(left, ast.Div(), right):
                # The quotient rule, with the division done once.
                inverse = f"(1.0 / ({ast.unparse(right)}))"
                above, below = self._derivative(left), self._derivative(right)
                if below == "zero()":
                    return f"{inverse} * ({above})"
                return f"{inverse} * ({above} - ({ast.unparse(value)}) * ({below}))"
        expression = _symbolic(value)
        symbols = sorted(expression.free_symbols, key=str)
        names = [(s, self._name(str(s))) for s in symbols]
        partials = [(sympy.diff(expression, s), name) for s, name in names if name]
        if len(symbols) == 1 and expression.is_polynomial():
            partials = [(sympy.horner(partial), name) for partial, name in partials]
        return _sum(partials)

    def _emit(self, indent: int, text: str) -> None:
        self.lines.append("    " * indent + text)

    def _call(self, call: ast.Call) -> str:
        """The call with the derivatives of its arguments handed over."""
        assert isinstance(call.func, ast.Name)
        given = [a for a in call.args if not (isinstance(a, ast.Name) and a.id in SHARED)]
        texts = []
        for formal, actual in zip(self.formals[call.func.id], given, strict=True):
            texts.append(ast.unparse(actual))
            if formal not in FIXED_ARGUMENTS:
                texts.append(self._derivative(actual))
        return f"{call.func.id}_t({', '.join([*texts, 'x, xd, p, pd, k'])})"

    def _statement(self, node: ast.stmt, indent: int) -> None:
        match node:
            case ast.Assign([target], value):
                name = ast.unparse(target)
                if name in self.discrete:
                    self._emit(indent, f"{name} = {ast.unparse(value)}")
                elif isinstance(value, ast.Call) and ast.unparse(value.func) in self.formals:
                    self._emit(indent, f"{name}, d_{name} = {self._call(value)}")
                elif name.startswith("x["):
                    self._emit(indent, f"put(xd, {name[2:-1]}, {self._derivative(value)})")
                    self._emit(indent, f"{name} = {ast.unparse(value)}")
                else:
                    self._emit(indent, f"d_{name} = {self._derivative(value)}")
                    self._emit(indent, f"{name} = {ast.unparse(value)}")
            case ast.Return(value) if value is not None:
                self._emit(indent, f"return {ast.unparse(value)}, {self._derivative(value)}")
            case ast.If(test, body, orelse):
                self._emit(indent, f"if {ast.unparse(test)}:")
                self._block(body, indent + 1)
                if orelse:
                    self._emit(indent, "else:")
                    self._block(orelse, indent + 1)
            case ast.For(target, iterator, body, []):
                self._emit(indent, f"for {ast.unparse(target)} in {ast.unparse(iterator)}:")
                self._block(body, indent + 1)
            case ast.Break():
                self._emit(indent, "break")
            case ast.Pass():
                self._emit(indent, "pass")
            case _:
                raise ValueError(f"the stepper's language has no {ast.unparse(node)!r}")

    def _block(self, body: list[ast.stmt], indent: int) -> None:
        for node in body:
            self._statement(node, indent)

    def write(self) -> str:
        self.lines = [_head(self.tree.name, self.formals[self.tree.name])]
        self._block(self.tree.body, 1)
        return "\n".join(self.lines)


def _head(name: str, formals: Iterable[str]) -> str:
    pairs = [f"{a}, d_{a}" if a not in FIXED_ARGUMENTS else a for a in formals]
    return f"def {name}_t({', '.join([*pairs, 'x, xd, p, pd, k'])}):"


def _law(slot: str, ids: list[str], numbers: dict[str, int]) -> str:
    """The derivative of a slot's laws, each behind its switch."""
    lines = [_head(slot, SLOTS[slot][0])]
    chain = slot == "drive"
    lines += ["    acts = command", "    d_acts = d_command"] if chain else ["    acts = 0.0", "    d_acts = zero()"]
    for effect in ids:
        law = trace(effect)
        active = [(argument(a), f"d_{a}") for a in SLOTS[slot][0] if a not in FIXED_ARGUMENTS]
        fitted = (s for s in law.parameters if s.name[2:] not in NEVER)
        active += [(s, f"row(pd, {numbers[s.name[2:]]})") for s in fitted]
        partials = [sympy.diff(law.expression, s) for s, _ in active]
        shared, results = sympy.cse([law.expression, *partials], sympy.numbered_symbols("s"))
        terms = _sum(zip(results[1:], (name for _, name in active), strict=True))
        lines.append(f"    if has.{effect}:")
        lines += [f"        {name} = {code(expression)}" for name, expression in shared]
        value = code(results[0])
        if chain:
            lines += [f"        d_command = {terms}", f"        command = {value}"]
            lines += ["        acts = command", "        d_acts = d_command"]
        else:
            lines += [f"        d_acts = d_acts + ({terms})", f"        acts = acts + {value}"]
    lines.append("    return acts, d_acts")
    return "\n".join(lines)


def write(numbers: Numbering) -> str:
    """Text of the derivative of everything, with names resolved by `numbers`.

    `step_t(command, d_command, h, d_h, x, xd, p, pd, k)`, one per function of the stepper and one per slot; each
    returns its value and the derivative of that.
    """
    laws = laws_by_slot(EVERYTHING, numbers)
    functions = [
        f for f in module(EVERYTHING, numbers=numbers).body if isinstance(f, ast.FunctionDef) and f.name not in laws
    ]
    formals = {f.name: tuple(a.arg for a in f.args.args if a.arg not in SHARED) for f in functions}
    formals |= {slot: SLOTS[slot][0] for slot in laws}
    texts = [ast.unparse(resolve(_law(slot, ids, dict(numbers.parameters)), numbers)) for slot, ids in laws.items()]
    return "\n\n\n".join(texts + [FunctionDerivative(f, formals).write() for f in functions])

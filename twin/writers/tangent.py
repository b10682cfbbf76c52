"""The exact derivative of the axis, written from its own text (forward mode, source to source).

Every scalar of the stepper gets a row in a work array `w`: its derivatives with respect to the n parameters
that are being estimated. `xd` holds those of the states; `col[i]` is the column of parameter i, or -1 where it
is held fixed. Laws are differentiated by SymPy, assignments of the stepper one at a time; branches and event
times are followed as computed, so the derivative is that of the computed trajectory, not of an approximation.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass, field

import sympy

from twin.axis import EVERYTHING
from twin.effects.effect import SLOTS
from twin.equations import argument, trace
from twin.writers.python import code, laws_by_slot, module, numbering, resolve

_MATH = {"sqrt": sympy.sqrt, "exp": sympy.exp}
_SHARED = ("x", "p", "k")


@dataclass
class _Rows:
    """Row of the work array for each scalar of each function."""

    rows: dict[str, int] = field(default_factory=dict)

    def of(self, function: str, name: str) -> int:
        return self.rows.setdefault(f"{function}.{name}", len(self.rows))


def _symbol(node: ast.expr) -> sympy.Symbol:
    return sympy.Symbol(ast.unparse(node), real=True)


def _symbolic(node: ast.expr) -> sympy.Expr:
    """A stepper expression as SymPy; names and subscripts become symbols named by their text."""
    match node:
        case ast.Constant(value):
            return sympy.Float(value) if isinstance(value, float) else sympy.Integer(value)
        case ast.Name() | ast.Subscript():
            return _symbol(node)
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


class _Function:
    """Writes the derivative of one stepper function."""

    def __init__(self, tree: ast.FunctionDef, rows: _Rows, known: set[str], laws: set[str]) -> None:
        self.tree = tree
        self.name = tree.name
        self.rows = rows
        self.known = known
        self.laws = laws
        self.scalars = {a.arg for a in tree.args.args if a.arg not in _SHARED}
        self.discrete = self._discrete()
        self.lines: list[str] = []

    def _discrete(self) -> set[str]:
        """Names that only ever hold whole numbers: flags, not quantities."""
        values: dict[str, bool] = {}
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                whole = isinstance(node.value, ast.Constant) and isinstance(node.value.value, int)
                name = node.targets[0].id
                values[name] = values.get(name, True) and whole
        return {name for name, whole in values.items() if whole}

    def _place(self, text: str) -> str | None:
        """Where the derivative of a symbol stands, or None where it is zero or handled by column."""
        if text.startswith("x["):
            return f"xd[{text[2:-1]}, j]"
        if text[:2] in ("p[", "k[") or text in self.discrete:
            return None
        return f"w[{self.rows.of(self.name, text)}, j]"

    def _emit(self, indent: int, text: str) -> None:
        self.lines.append("    " * indent + text)

    def _derive(self, value: ast.expr, row: str, indent: int) -> None:
        """Write the derivative of an expression into `row` ("w[3, {j}]")."""
        expression = _symbolic(value)
        terms, columns = [], []
        for n, symbol in enumerate(sorted(expression.free_symbols, key=str)):
            partial = sympy.diff(expression, symbol)
            place = self._place(str(symbol))
            if place is not None:
                self._emit(indent, f"c{n} = {code(partial)}")
                terms.append(f"c{n} * {place}")
            elif str(symbol).startswith("p["):
                self._emit(indent, f"c{n} = {code(partial)}")
                columns.append((str(symbol)[2:-1], f"c{n}"))
        self._emit(indent, "for j in range(n):")
        self._emit(indent + 1, f"{row.format(j='j')} = {' + '.join(terms) or '0.0'}")
        for index, factor in columns:
            self._emit(indent, f"if col[{index}] >= 0:")
            self._emit(indent + 1, f"{row.format(j=f'col[{index}]')} += {factor}")

    def _call(self, call: ast.Call, indent: int) -> str:
        """Hand the derivatives of the arguments over and return the call's text."""
        assert isinstance(call.func, ast.Name)
        callee = call.func.id
        names = SLOTS[callee][0] if callee in self.laws else self._formals[callee]
        given = [a for a in call.args if not (isinstance(a, ast.Name) and a.id in _SHARED)]
        texts = []
        for formal, actual in zip(names, given, strict=True):
            if formal not in _FIXED_ARGUMENTS:
                row = self.rows.of(callee, formal)
                self._derive(actual, f"w[{row}, {{j}}]", indent)
            texts.append(ast.unparse(actual))
        return f"{callee}_t({', '.join([*texts, 'x, xd, p, col, k, w, n'])})"

    _formals: dict[str, tuple[str, ...]] = {}  # noqa: RUF012  filled by write()

    def _statement(self, node: ast.stmt, indent: int) -> None:
        match node:
            case ast.Assign([target], value):
                name = ast.unparse(target)
                if name in self.discrete:
                    self._emit(indent, f"{name} = {ast.unparse(value)}")
                    return
                row = (
                    f"xd[{name[2:-1]}, {{j}}]"
                    if name.startswith("x[")
                    else f"w[{self.rows.of(self.name, name)}, {{j}}]"
                )
                if (
                    isinstance(value, ast.Call)
                    and isinstance(value.func, ast.Name)
                    and value.func.id in self.known
                ):
                    text = self._call(value, indent)
                    self._emit(indent, f"{name} = {text}")
                    result = self.rows.of(value.func.id, "return")
                    self._emit(indent, "for j in range(n):")
                    self._emit(indent + 1, f"{row.format(j='j')} = w[{result}, j]")
                    return
                self._derive(value, row, indent)
                self._emit(indent, f"{name} = {ast.unparse(value)}")
            case ast.Return(value) if value is not None:
                self._derive(value, f"w[{self.rows.of(self.name, 'return')}, {{j}}]", indent)
                self._emit(indent, f"return {ast.unparse(value)}")
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
        formals = [a.arg for a in self.tree.args.args if a.arg not in _SHARED]
        self.lines = [f"def {self.name}_t({', '.join([*formals, 'x, xd, p, col, k, w, n'])}):"]
        self._block(self.tree.body, 1)
        return "\n".join(self.lines)


#: Arguments of laws that never depend on a parameter.
_FIXED_ARGUMENTS = frozenset({"direction", "moment", "payload"})


def _law(slot: str, ids: list[str], rows: _Rows) -> str:
    """The derivative of a slot's laws, each behind its switch."""
    arguments = SLOTS[slot][0]
    out = rows.of(slot, "return")
    live = [a for a in arguments if a not in _FIXED_ARGUMENTS]
    lines = [f"def {slot}_t({', '.join([*arguments, 'x, xd, p, col, k, w, n'])}):"]
    chain = slot == "drive"
    lines.append(f"    acts = {'command' if chain else '0.0'}")
    for a in live if not chain else []:
        lines.append(f"    d_{a} = 0.0")
    start = f"w[{rows.of(slot, 'command')}, j]" if chain else "0.0"
    lines += ["    for j in range(n):", f"        w[{out}, j] = {start}"]
    for effect in ids:
        law = trace(effect)
        by_argument = [sympy.diff(law.expression, argument(a)) for a in live]
        by_parameter = [sympy.diff(law.expression, s) for s in law.parameters]
        shared, results = sympy.cse(
            [law.expression, *by_argument, *by_parameter], sympy.numbered_symbols("s")
        )
        value, *partials = results
        lines.append(f"    if has.{effect}:")
        lines += [f"        {name} = {code(expression)}" for name, expression in shared]
        if chain:
            factors = [(a, code(partial)) for a, partial in zip(live, partials, strict=False) if partial != 0]
            lines += [f"        d_{a} = {text}" for a, text in factors]
            terms = [f"d_{a} * w[{out if a == 'command' else rows.of(slot, a)}, j]" for a, _ in factors]
            lines += ["        for j in range(n):", f"            w[{out}, j] = {' + '.join(terms) or '0.0'}"]
        else:
            lines += [
                f"        d_{a} += {code(partial)}"
                for a, partial in zip(live, partials, strict=False)
                if partial != 0
            ]
        for s, partial in zip(law.parameters, partials[len(live) :], strict=True):
            if partial != 0:
                lines.append(f"        if col[index.{s.name[2:]}] >= 0:")
                lines.append(f"            w[{out}, col[index.{s.name[2:]}]] += {code(partial)}")
        if chain:
            lines += [f"        command = {code(value)}", "        acts = command"]
        else:
            lines.append(f"        acts = acts + {code(value)}")
    if not chain:
        terms = [f"d_{a} * w[{rows.of(slot, a)}, j]" for a in live]
        lines += ["    for j in range(n):", f"        w[{out}, j] += {' + '.join(terms)}"]
    lines.append("    return acts")
    return "\n".join(lines)


class _Index(ast.NodeTransformer):
    """index.name -> the parameter's number."""

    def __init__(self, parameters: dict[str, int]) -> None:
        self.parameters = parameters

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        if isinstance(node.value, ast.Name) and node.value.id == "index":
            return ast.Constant(self.parameters[node.attr])
        return node


@dataclass(frozen=True)
class Tangent:
    """The text of the derivative, and the rows of `w` that a caller fills or reads."""

    text: str
    rows: dict[str, int]


def write() -> Tangent:
    """The switched kernel's derivative: `step_t(command, h, x, xd, p, col, k, w, n)` and one per law."""
    rows = _Rows()
    numbers = numbering(EVERYTHING, True)
    laws = laws_by_slot(EVERYTHING)
    values = module(EVERYTHING, True)
    functions = [f for f in values.body if isinstance(f, ast.FunctionDef) and f.name not in laws]
    known = {f.name for f in functions} | set(laws)
    _Function._formals = {
        f.name: tuple(a.arg for a in f.args.args if a.arg not in _SHARED) for f in functions
    }
    law_texts = []
    for slot, ids in laws.items():
        tree = ast.parse(_law(slot, ids, rows))
        tree = _Index(dict(numbers.parameters)).visit(tree)
        law_texts.append(ast.unparse(resolve(ast.unparse(tree), numbers)))
    texts = [_Function(f, rows, known, set(laws)).write() for f in functions]
    return Tangent("\n\n\n".join(law_texts + texts), dict(rows.rows))

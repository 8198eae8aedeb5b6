"""Translation of compiled Python functions into C99.

A small subset of Python has a translation: numbers, arrays, named coefficients and parameters, loops over ranges, conditions
and calls. Anything else is refused with its line.
"""

import ast
import builtins
import inspect
import math
import re
import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from mrd_base import InputError
from mrd_sim import dual
from mrd_sim.named import named, named_row

_SAME_IN_C = re.findall(
    r"\w+",
    "exp expm1 log log1p sqrt sin cos tan asin acos atan atan2 sinh cosh tanh asinh acosh atanh erf pow fabs hypot copysign",
)
_LIBRARY = {
    getattr(module, name): name
    for module in (math, dual)
    for name in _SAME_IN_C
    if hasattr(module, name) and not hasattr(getattr(module, name), "py_func")
} | {builtins.abs: "fabs", builtins.min: "fmin", builtins.max: "fmax"}

# Operators in C, with how tightly they bind.
_SUM, _PRODUCT, _EQUALITY, _ORDER = 6, 7, 4, 5
_BINARY: dict[type[ast.operator], tuple[str, int]] = {
    ast.Add: ("+", _SUM),
    ast.Sub: ("-", _SUM),
    ast.Mult: ("*", _PRODUCT),
    ast.Div: ("/", _PRODUCT),
    ast.FloorDiv: ("/", _PRODUCT),
}
_COMPARISONS: dict[type[ast.cmpop], tuple[str, int]] = {
    ast.Eq: ("==", _EQUALITY),
    ast.NotEq: ("!=", _EQUALITY),
    ast.Lt: ("<", _ORDER),
    ast.LtE: ("<=", _ORDER),
    ast.Gt: (">", _ORDER),
    ast.GtE: (">=", _ORDER),
}

_C_TYPES = {
    "float": "double",
    "Any": "double",
    "complex": "double",
    "int": "int",
    "bool": "int",
    "Array": "double *",
    "NDArray[np.intp]": "int *",
    "Row": "const double *",
}
"""C type of a parameter by its annotation."""

# Keywords of C that are not Python's, and the name of a parameter that functions on arrays are given.
_RESERVED = set(
    re.findall(
        r"\w+",
        """auto case char const default do double enum extern float goto inline int long register restrict return short
        signed sizeof static struct switch typedef union unsigned void volatile vertices""",
    )
)


def c_comment(text: str) -> str:
    """Return text in one line that does not end a C comment."""
    return " ".join(text.replace("*/", "* /").split())


def c_number(value: float) -> str:
    """Return a number as C reads it."""
    if not math.isfinite(value):
        raise InputError(f"{value} has no translation to C, expected a finite number")
    return repr(float(value))


@dataclass(frozen=True)
class _Signature:
    """A translated function.

    ``result`` is its C type and ``parts`` the length of the tuple that it returns, or 0. For each parameter, ``kinds`` has
    the C type and ``writes`` whether it is written to; ``defaults`` are those of the last ones.
    """

    name: str
    result: str
    parts: int
    kinds: tuple[str, ...]
    writes: tuple[bool, ...]
    defaults: tuple[Any, ...]


class CUnit:
    """C functions and constants, each after those that it needs.

    Parameters
    ----------
    coefficients : sequence of str
        Names of the entries of a row.
    names : set of str
        C names that are in use already.

    Attributes
    ----------
    columns : dict
        C name of the index of each coefficient in a row, by its name.
    """

    def __init__(self, coefficients: Sequence[str], names: set[str]) -> None:
        self.columns = {name: f"C_{name.upper()}" for name in coefficients}
        self._text: list[str] = []
        self._names = names
        self._constants: dict[tuple[str, Any], str] = {}
        self._functions: dict[Callable[..., Any], _Signature | None] = {}

    @property
    def text(self) -> str:
        """C source of all functions and constants so far."""
        return "\n".join(self._text)

    def function(self, compiled: Any, kinds: Sequence[str] = ()) -> _Signature:
        """Translate a compiled function, once; ``kinds`` are the C types of its parameters, or its annotations say them."""
        python = getattr(compiled, "py_func", compiled)
        if python not in self._functions:
            self._functions[python] = None
            translated = _Function(self, python, kinds)
            self._text.append(translated.text)
            self._functions[python] = translated.signature
        signature = self._functions[python]
        if signature is None:
            raise InputError(f"{python.__module__}.{python.__name__} calls itself, which has no translation to C")
        return signature

    def constant(self, module: str, name: str, value: float | tuple[float, ...]) -> str:
        """Return the C name of a constant of a module: a number, or an array for a tuple."""
        key = (f"{module}.{name}", value)
        if key not in self._constants:
            chosen = self._constants[key] = self.name(module, name)
            array, text = (
                ("[]", f"{{{', '.join(map(c_number, value))}}}") if isinstance(value, tuple) else ("", c_number(value))
            )
            self._text.append(f"static const double {chosen}{array} = {text};\n")
        return self._constants[key]

    def structure(self, kind: Any) -> str:
        """Return the C name of a structure with the fields of a type of named tuples."""
        key = (f"{kind.__module__}.{kind.__name__}", kind)
        if key not in self._constants:
            self._constants[key] = self.name(kind.__module__, kind.__name__)
            fields = ", ".join(map(_c, kind._fields))
            self._text.append(f"typedef struct {{ double {fields}; }} {self._constants[key]};\n")
        return self._constants[key]

    def name(self, module: str, name: str) -> str:
        """Choose a C name that is still free."""
        free = f"{module.rpartition('.')[2]}_{name.strip('_')}"
        while free in self._names:
            free += "_"
        self._names.add(free)
        return free


class _Function:
    """Translation of one function.

    Numbers are double or, where Python has integers, int. An array is a pointer. An array with two indices holds row after
    row of the model's coefficients or, if of integers, of the columns of their laws' parameters. A named row of coefficients
    is a pointer to its first, a named vector a structure. An array that is made and returned becomes one more parameter. A
    number with a derivative is its value.
    """

    def __init__(self, unit: CUnit, python: Callable[..., Any], kinds: Sequence[str]) -> None:
        self.unit, self.python = unit, python
        self.module = python.__module__
        lines, self.first = inspect.getsourcelines(python)
        tree = ast.parse(textwrap.dedent("".join(lines))).body[0]
        if not isinstance(tree, ast.FunctionDef):
            raise InputError(f"{self.module}: {python.__name__} is not a function, which has no translation to C")
        self.tree = tree
        nodes = sorted(ast.walk(tree), key=lambda node: (getattr(node, "lineno", 0), getattr(node, "col_offset", 0)))
        self.parameters = {arg.arg: kinds[index] if kinds else self._c_type(arg) for index, arg in enumerate(tree.args.args)}
        self.rows = {name for name, kind in self.parameters.items() if kind == _C_TYPES["Row"]}
        self.rows |= self._made_by(named_row, nodes).keys()
        self.vectors = {name: self._global(call.args[0])._fields for name, call in self._made_by(named, nodes).items()}
        self.made = {
            name.id
            for node in nodes
            if isinstance(node, ast.Assign) and self._makes_array(node.value)
            for name in node.targets
            if isinstance(name, ast.Name)
        }
        self._check_loops(nodes)
        self.written: set[str] = set(self.made)
        stored = [node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)]
        self.counters = {node.target.id for node in nodes if isinstance(node, ast.For) and isinstance(node.target, ast.Name)}
        declared = self.parameters.keys() | self.made | self.counters | self.rows | self.vectors.keys()
        self.locals = [name for name in dict.fromkeys(stored) if name not in declared]
        self.integers = self._find_integers(nodes)
        returned = [node.value for node in nodes if isinstance(node, ast.Return) and node.value is not None]
        lengths = {len(value.elts) if isinstance(value, ast.Tuple) else 0 for value in returned}
        if len(lengths) > 1:
            raise self._refuse(tree.args, "a function that returns tuples of different length")
        parts = lengths.pop() if lengths else 0
        name = unit.name(self.module, tree.name)
        if not returned or self.made:
            self.result = "void"
        elif parts:
            self.result = f"{name}_result"
        else:
            self.result = "int" if all(map(self._is_integer, returned)) else "double"
        self.temporaries = 0
        last = tree.body[-1]
        ends = isinstance(last, ast.Return) and self.result == "void"
        body = self._block(tree.body[:-1] if ends else tree.body, 1)
        writes = tuple(parameter in self.written for parameter in self.parameters)
        defaults = python.__defaults__ or ()
        self.signature = _Signature(name, self.result, parts, tuple(self.parameters.values()), writes, defaults)
        self.text = self._head(parts, name) + self._declarations() + body + "}\n"

    def _head(self, parts: int, name: str) -> str:
        structure = ""
        if parts:
            structure = f"typedef struct {{ double {', '.join(f'_{i}' for i in range(parts))}; }} {self.result};\n\n"
        listed = ["int vertices"] if self.made or any(map(self._is_array, self.parameters)) else []
        for parameter, kind in self.parameters.items():
            constant = "const " if self._is_array(parameter) and parameter not in self.written else ""
            listed.append(f"{constant}{kind}{'' if kind.endswith('*') else ' '}{_c(parameter)}")
        listed += [f"double *{_c(made)}" for made in sorted(self.made)]
        summary = c_comment((ast.get_docstring(self.tree) or "").partition("\n\n")[0])
        comment = textwrap.fill(f"{summary} ({self.module})" if summary else self.module, 100, subsequent_indent="   ")
        signature = wrapped(f"static {self.result} {name}(", listed or ["void"], ")")
        return f"{structure}/* {comment} */\n{signature}\n{{\n"

    def _declarations(self) -> str:
        text = ""
        for kind, chosen in (
            ("double", [name for name in self.locals if name not in self.integers]),
            ("int", [name for name in self.locals if name in self.integers]),
        ):
            if chosen:
                text += wrapped(f"    {kind} ", [_c(name) for name in chosen], ";") + "\n"
        return text

    # What the names stand for.

    def _c_type(self, arg: ast.arg) -> str:
        annotation = ast.unparse(arg.annotation) if arg.annotation else ""
        if not annotation:
            raise self._refuse(arg, f"parameter {arg.arg} without a type (write {arg.arg}: float, int, bool or Array)")
        if annotation not in _C_TYPES:
            raise self._refuse(arg, f"parameter {arg.arg} of type {annotation}")
        return _C_TYPES[annotation]

    def _made_by(self, function: Callable[..., Any], nodes: Sequence[ast.AST]) -> dict[str, ast.Call]:
        """Names that calls of a function are assigned to, and the calls."""
        return {
            node.targets[0].id: node.value
            for node in nodes
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and isinstance(node.value, ast.Call)
            if isinstance(node.value.func, ast.Name) and self.python.__globals__.get(node.value.func.id) is function
        }

    def _makes_array(self, node: ast.AST) -> bool:
        return isinstance(node, ast.Call) and ast.unparse(node.func) in ("np.empty", "np.empty_like")

    def _check_loops(self, nodes: Sequence[ast.AST]) -> None:
        """Refuse loops with another meaning in C: that change their counter or bounds, or whose counter outlives them."""
        loops = [loop for loop in nodes if isinstance(loop, ast.For)]
        within: dict[str, set[ast.AST]] = {}
        for loop in loops:
            inside = [node for part in loop.body for node in ast.walk(part) if isinstance(node, ast.Name)]
            changed = {node.id for node in inside if isinstance(node.ctx, ast.Store)}
            if changed & (_names(loop.target) | _names(loop.iter)) or loop.orelse:
                raise self._refuse(loop, "a loop that changes its own counter or bounds, or has an else")
            if isinstance(loop.target, ast.Name):
                within.setdefault(loop.target.id, set()).update(ast.walk(loop))
        for node in nodes:
            if isinstance(node, ast.Name) and node not in within.get(node.id, {node}):
                raise self._refuse(node, f"{node.id} outside of its loop")

    def _assignments(self, nodes: Sequence[ast.AST]) -> Iterator[tuple[str, ast.expr | None]]:
        """Names and what is assigned to them; None for a part of something that is not written out."""
        for node in nodes:
            match node:
                case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Tuple(elts=values)):
                    yield from ((t.id, v) for t, v in zip(targets, values, strict=True) if isinstance(t, ast.Name))
                case ast.Assign(targets=[ast.Tuple(elts=targets)]):
                    yield from ((target.id, None) for target in targets if isinstance(target, ast.Name))
                case (
                    ast.Assign(targets=[ast.Name(id=name)], value=value)
                    | ast.AnnAssign(target=ast.Name(id=name), value=value)
                ):
                    yield name, value
                case ast.AugAssign(target=ast.Name(id=name), op=op, value=value):
                    yield name, ast.BinOp(ast.Name(name, ast.Load()), op, value)

    def _find_integers(self, nodes: Sequence[ast.AST]) -> set[str]:
        """Local variables that only ever hold integers."""
        assignments = list(self._assignments(nodes))
        self.integers = set(self.locals)
        while True:
            real = {name for name, value in assignments if value is None or not self._is_integer(value)}
            if not self.integers & real:
                return self.integers
            self.integers -= real

    def _is_integer(self, node: ast.expr) -> bool:
        match node:
            case ast.Constant(value=value):
                return isinstance(value, int)
            case ast.Name(id=name):
                if name in self.parameters:
                    return self.parameters[name] == "int"
                if name in self.locals or name in self.counters:
                    return name in self.counters or name in self.integers
                return isinstance(self.python.__globals__.get(name), int)
            case ast.BinOp(left=left, op=op, right=right):
                return not isinstance(op, ast.Div | ast.Pow) and self._is_integer(left) and self._is_integer(right)
            case ast.UnaryOp(op=op, operand=operand):
                return isinstance(op, ast.Not) or self._is_integer(operand)
            case ast.Compare() | ast.BoolOp():
                return True
            case ast.IfExp(body=body, orelse=orelse):
                return self._is_integer(body) and self._is_integer(orelse)
            case ast.Attribute(value=value, attr="real"):
                return self._is_integer(value)
            case ast.Subscript(value=ast.Name(id=name)):
                return self.parameters.get(name) == "int *"
            case ast.Call(func=ast.Name(id="len" | "int")):
                return True
            case ast.Call(func=func):
                called = self._global(func)
                return hasattr(called, "py_func") and self.unit.function(called).result == "int"
        return False

    def _global(self, node: ast.expr) -> Any:
        """Return what a name, or an attribute of a module, stands for outside of the function."""
        value = None
        match node:
            case ast.Name(id=name):
                value = self.python.__globals__.get(name, getattr(builtins, name, None))
            case ast.Attribute(value=ast.Name(id=module), attr=name):
                value = getattr(self.python.__globals__.get(module), name, None)
        if value is None:
            raise self._refuse(node, ast.unparse(node))
        return value

    def _refuse(self, node: ast.AST, what: str) -> InputError:
        line = self.first + getattr(node, "lineno", 1) - 1
        return InputError(f"{self.module}.{self.python.__name__}, line {line}: {what} has no translation to C")

    # Statements.

    def _block(self, nodes: Sequence[ast.stmt], depth: int) -> str:
        return "".join("    " * depth + line + "\n" for node in nodes for line in self._statement(node))

    def _inner(self, nodes: Sequence[ast.stmt]) -> list[str]:
        return ["    " + line for node in nodes for line in self._statement(node)]

    def _statement(self, node: ast.stmt) -> list[str]:
        match node:
            case ast.Expr(value=ast.Constant(value=str())) | ast.Pass():
                return []
            case ast.Assign(value=value) if self._makes_array(value):
                return []
            case ast.Assign(targets=[ast.Name(id=name)], value=ast.Call(args=[_, matrix, row])) if name in self.rows:
                return [f"const double *{_c(name)} = {self._text(matrix)} + {self._text(row, _PRODUCT)} * COEFFICIENTS;"]
            case ast.Assign(targets=[ast.Name(id=name)], value=ast.Call(args=[kind, vector])) if name in self.vectors:
                if not (isinstance(vector, ast.Name) and self._is_array(vector.id)):
                    raise self._refuse(vector, f"{ast.unparse(vector)} as an array")
                entries = ", ".join(f"{self._text(vector)}[{index}]" for index in range(len(self.vectors[name])))
                return [f"const {self.unit.structure(self._global(kind))} {_c(name)} = {{{entries}}};"]
            case ast.Assign(targets=[target], value=value):
                return self._assign(target, value)
            case ast.AnnAssign(target=target, value=ast.expr() as value):
                return self._assign(target, value)
            case ast.AugAssign(target=target, op=op, value=value):
                load = ast.copy_location(ast.BinOp(target, op, value), node)
                return self._assign(target, load)
            case ast.If(test=test, body=body, orelse=orelse):
                lines = [f"if ({self._text(test)}) {{", *self._inner(body), "}"]
                match orelse:
                    case []:
                        return lines
                    case [ast.If()]:
                        first, *rest = self._statement(orelse[0])
                        return [*lines[:-1], f"}} else {first}", *rest]
                return [*lines[:-1], "} else {", *self._inner(orelse), "}"]
            case ast.For(target=ast.Name(id=counter), iter=ast.Call(func=ast.Name(id="range"), args=args), body=body):
                bounds = [self._text(arg) for arg in args]
                start, stop = ("0", bounds[0]) if len(bounds) == 1 else bounds[:2]
                step = ast.literal_eval(args[2]) if len(args) == 3 and isinstance(args[2], ast.UnaryOp | ast.Constant) else 1
                if len(args) == 3 and str(step) != bounds[2]:
                    raise self._refuse(node, f"{ast.unparse(node.iter)} with a variable step")
                name = _c(counter)
                compare = "<" if step > 0 else ">"
                advance = {1: f"{name}++", -1: f"{name}--"}.get(step, f"{name} += {step}")
                return [f"for (int {name} = {start}; {name} {compare} {stop}; {advance}) {{", *self._inner(body), "}"]
            case ast.While(test=test, body=body, orelse=[]):
                return [f"while ({self._text(test)}) {{", *self._inner(body), "}"]
            case ast.Break():
                return ["break;"]
            case ast.Continue():
                return ["continue;"]
            case ast.Return(value=None):
                return ["return;"]
            case ast.Return(value=ast.Tuple(elts=elts)):
                return [f"return ({self.result}){{{', '.join(self._text(element) for element in elts)}}};"]
            case ast.Return(value=ast.Name(id=name)) if name in self.made:
                return ["return;"]
            case ast.Return(value=ast.expr() as value):
                return [f"return {self._text(value)};"]
        raise self._refuse(node, ast.unparse(node).partition("\n")[0])

    def _assign(self, target: ast.expr, value: ast.expr) -> list[str]:
        if not isinstance(target, ast.Tuple):
            return [f"{self._target(target)} = {self._text(value)};"]
        targets = [self._target(element) for element in target.elts]
        if isinstance(value, ast.Tuple):
            values = [self._text(element) for element in value.elts]
            pairs = [f"{left} = {right};" for left, right in zip(targets, values, strict=True)]
            if not any(_names(a) & _names(b) for i, a in enumerate(target.elts) for b in value.elts[i + 1 :]):
                return pairs
            # One target is needed for a later value: first compute all values.
            names = [self._temporary() for _ in values]
            return [
                *(f"const double {name} = {right};" for name, right in zip(names, values, strict=True)),
                *(f"{left} = {name};" for left, name in zip(targets, names, strict=True)),
            ]
        called = self.unit.function(self._global(value.func)) if isinstance(value, ast.Call) else None
        if called is None or called.parts != len(targets):
            raise self._refuse(value, f"{ast.unparse(target)} = {ast.unparse(value)}")
        name = self._temporary()
        return [
            f"const {called.result} {name} = {self._text(value)};",
            *(f"{left} = {name}._{index};" for index, left in enumerate(targets)),
        ]

    def _temporary(self) -> str:
        self.temporaries += 1
        return f"result{self.temporaries}"

    def _target(self, node: ast.expr) -> str:
        if isinstance(node, ast.Subscript) and isinstance(node.value, ast.Name):
            self.written.add(node.value.id)
        if not isinstance(node, ast.Subscript | ast.Name):
            raise self._refuse(node, ast.unparse(node))
        return self._text(node)

    # Expressions: their text and how tightly it binds, from 1 (?:) to 9 (a name).

    def _text(self, node: ast.expr, least: int = 0) -> str:
        text, binds = self._expression(node)
        return text if binds >= least else f"({text})"

    def _expression(self, node: ast.expr) -> tuple[str, int]:
        match node:
            case ast.Constant(value=bool() | int() as value):
                return str(int(value)), 9
            case ast.Constant(value=float() as value):
                return c_number(value), 9
            case ast.Name(id=name):
                return self._name(node, name), 9
            case ast.Attribute(value=value, attr="real"):
                return self._expression(value)
            case ast.Attribute(value=ast.Name(id=name), attr=field) if name in self.rows:
                if field not in self.unit.columns:
                    raise self._refuse(node, f"{name}.{field}, which is not a coefficient of the model,")
                return f"{_c(name)}[{self.unit.columns[field]}]", 9
            case ast.Attribute(value=ast.Name(id=name), attr=field) if field in self.vectors.get(name, ()):
                return f"{_c(name)}.{_c(field)}", 9
            case ast.Attribute():
                return c_number(self._value(node)), 9
            case ast.Subscript():
                return self._element(node), 9
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return f"pow({self._text(left)}, {self._text(right)})", 9
            case ast.BinOp(left=left, op=ast.Mod(), right=right) if self._is_integer(node):
                divisor = self._text(right, 8)  # the remainder has the divisor's sign in Python, the dividend's in C
                return f"({self._text(left, _PRODUCT)} % {divisor} + {divisor}) % {divisor}", _PRODUCT
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
                sign, binds = _BINARY[type(op)]
                whole = self._is_integer(left) and self._is_integer(right)
                if isinstance(op, ast.FloorDiv) and not whole:
                    raise self._refuse(node, ast.unparse(node))
                first = self._text(left, binds)
                if isinstance(op, ast.Div) and whole:
                    first = f"(double){self._text(left, 8)}"
                return f"{first} {sign} {self._text(right, binds + 1)}", binds
            case ast.UnaryOp(op=ast.USub() | ast.Not() as op, operand=operand):
                text = self._text(operand, 8)
                return (f"!{text}" if isinstance(op, ast.Not) else f"-({text})" if text[0] == "-" else f"-{text}"), 8
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self._expression(operand)
            case ast.Compare(left=left, ops=ops, comparators=comparators):
                terms, parts = [left, *comparators], []
                for comparison, (before, after) in zip(ops, pairwise(terms), strict=True):
                    if type(comparison) not in _COMPARISONS:
                        raise self._refuse(node, ast.unparse(node))
                    sign, binds = _COMPARISONS[type(comparison)]
                    parts.append(f"{self._text(before, _SUM)} {sign} {self._text(after, _SUM)}")
                return " && ".join(parts), binds if len(parts) == 1 else 3
            case ast.BoolOp(op=op, values=values) if all(map(self._is_integer, values)):
                sign, binds = (" && ", 3) if isinstance(op, ast.And) else (" || ", 2)
                return sign.join(self._text(value, 4) for value in values), binds
            case ast.IfExp(test=test, body=body, orelse=orelse):
                return f"{self._text(test, 2)} ? {self._text(body, 2)} : {self._text(orelse, 1)}", 1
            case ast.Call(func=ast.Name(id="len"), args=[ast.Name(id=name)]) if name not in ("state", "parameters"):
                return ("COEFFICIENTS" if self.parameters.get(name) == "int *" else "vertices"), 9
            case ast.Call(func=ast.Name(id="float" | "int" as kind), args=[value]):
                return f"({_C_TYPES[kind]}){self._text(value, 8)}", 8
            case ast.Call(keywords=[]):
                return self._call(node), 9
        raise self._refuse(node, ast.unparse(node))

    def _name(self, node: ast.expr, name: str) -> str:
        if name in self.parameters or name in self.locals or name in self.made | self.counters | self.rows:
            return _c(name)
        value = self._value(node)
        return str(int(value)) if isinstance(value, int) else self.unit.constant(self.module, name, value)

    def _value(self, node: ast.expr) -> float:
        value = self._global(node)
        if not isinstance(value, int | float):
            raise self._refuse(node, ast.unparse(node))
        return value

    def _element(self, node: ast.Subscript) -> str:
        match node:
            case ast.Subscript(slice=ast.UnaryOp(op=ast.USub())):  # Python counts it from the end
                raise self._refuse(node, ast.unparse(node))
            case ast.Subscript(value=ast.Name(id=name), slice=ast.Tuple(elts=[row, column])) if self._is_array(name):
                width = "LAW_PARAMETERS" if self.parameters.get(name) == "int *" else "COEFFICIENTS"
                return f"{_c(name)}[{self._text(row, 7)} * {width} + {self._text(column, 6)}]"
            case ast.Subscript(value=ast.Name(id=name), slice=index) if self._is_array(name) and self._is_integer(index):
                return f"{_c(name)}[{self._text(index)}]"
            case ast.Subscript(value=ast.Name(id=name) as array, slice=index) if self._is_integer(index):
                values = self._global(array)
                if isinstance(values, tuple) and all(isinstance(value, int | float) for value in values):
                    return f"{self.unit.constant(self.module, name, values)}[{self._text(index)}]"
        raise self._refuse(node, ast.unparse(node))

    def _is_array(self, name: str) -> bool:
        return name in self.made or (self.parameters.get(name, "").endswith("*") and name not in self.rows)

    def _call(self, node: ast.Call) -> str:
        called = self._global(node.func)
        if called in _LIBRARY:
            if called in (builtins.min, builtins.max) and len(node.args) != 2:
                raise self._refuse(node, f"{ast.unparse(node)} of other than two numbers")
            return f"{_LIBRARY[called]}({', '.join(self._text(arg) for arg in node.args)})"
        if not hasattr(called, "py_func"):
            raise self._refuse(node, ast.unparse(node))
        target = self.unit.function(called)
        left_out = len(target.kinds) - len(node.args)
        arguments = [*node.args, *map(ast.Constant, target.defaults[len(target.defaults) - left_out :])]
        is_array = [kind.endswith("*") and kind != _C_TYPES["Row"] for kind in target.kinds]
        given = ["vertices"] if any(is_array) else []
        for arg, kind, array, written in zip(arguments, target.kinds, is_array, target.writes, strict=True):
            if array and not (isinstance(arg, ast.Name) and self._is_array(arg.id)):
                raise self._refuse(arg, f"{ast.unparse(arg)} as an array")
            if kind == _C_TYPES["Row"] and not (isinstance(arg, ast.Name) and arg.id in self.rows):
                raise self._refuse(arg, f"{ast.unparse(arg)} as a row of coefficients")
            if written and isinstance(arg, ast.Name):
                self.written.add(arg.id)
            given.append(self._text(arg))
        return f"{target.name}({', '.join(given)})"


def wrapped(head: str, parts: Sequence[str], tail: str) -> str:
    """Join a list that may break between its parts only."""
    whole = head + ", ".join(parts) + tail
    kept = whole.replace(" ", "\0").replace(",\0", ", ")
    indent = " " * (len(head) - len(head.lstrip()) + 4)
    return textwrap.fill(kept, 110, subsequent_indent=indent, break_long_words=False).replace("\0", " ")


def _names(node: ast.expr) -> set[str]:
    return {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}


def _c(name: str) -> str:
    return f"{name}_" if name in _RESERVED else name

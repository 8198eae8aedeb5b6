"""A damper model with its parameters as one self-contained C file.

The C functions are translated from the Python source of those that the simulator itself runs: the model's kernel, the
current laws, the coil lag and whatever they call. So there is one truth, in Python, and C follows it.
"""

import ast
import builtins
import inspect
import math
import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from string import Template
from typing import Any

from mrd_base import InputError
from mrd_sim import current, dual
from mrd_sim.models import DamperModel

_SAME_IN_C = (
    "exp",
    "expm1",
    "log",
    "log1p",
    "sqrt",
    "sin",
    "cos",
    "tan",
    "asin",
    "acos",
    "atan",
    "atan2",
    "sinh",
    "cosh",
    "tanh",
    "asinh",
    "acosh",
    "atanh",
    "erf",
    "pow",
    "fabs",
    "hypot",
    "copysign",
)
_LIBRARY = {
    getattr(module, name): name
    for module in (math, dual)
    for name in _SAME_IN_C
    if hasattr(module, name) and not hasattr(getattr(module, name), "py_func")
} | {builtins.abs: "fabs", builtins.min: "fmin", builtins.max: "fmax"}

_BINARY: dict[type[ast.operator], tuple[str, int]] = {
    ast.Add: ("+", 6),
    ast.Sub: ("-", 6),
    ast.Mult: ("*", 7),
    ast.Div: ("/", 7),
    ast.FloorDiv: ("/", 7),
}
_COMPARISONS: dict[type[ast.cmpop], tuple[str, int]] = {
    ast.Eq: ("==", 4),
    ast.NotEq: ("!=", 4),
    ast.Lt: ("<", 5),
    ast.LtE: ("<=", 5),
    ast.Gt: (">", 5),
    ast.GtE: (">=", 5),
}

# Keywords of C that are none of Python's, and a parameter that functions on arrays are given.
_TAKEN = {
    "auto",
    "case",
    "char",
    "const",
    "default",
    "do",
    "double",
    "enum",
    "extern",
    "float",
    "goto",
    "inline",
    "int",
    "long",
    "register",
    "restrict",
    "return",
    "short",
    "signed",
    "sizeof",
    "static",
    "struct",
    "switch",
    "typedef",
    "union",
    "unsigned",
    "void",
    "volatile",
    "vertices",
}


def c_source(model: DamperModel, values: Mapping[str, float], prefix: str = "mrd") -> str:
    """Translate a damper model into C99.

    Parameters
    ----------
    model : DamperModel
    values : mapping
        Parameters by name in SI; those not given keep the model's default.
    prefix : str
        What the names begin with that other C files see, so that several dampers fit into one program.

    Returns
    -------
    str
        A file that needs nothing but the C library. ``<prefix>_init`` makes a damper at rest with these parameters,
        ``<prefix>_step`` advances it to the next sample and returns the force that `DamperModel.force` has there along
        `make_path`.

    Raises
    ------
    InputError
        For an unknown parameter, a value out of bounds, a prefix that is no C name, a model with effects, or code that has
        no translation.
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", prefix):
        raise InputError(f"prefix {prefix!r} is no C name, expected letters, digits and _")
    if model.effects:
        found = ", ".join(effect.id for effect in model.effects)
        raise InputError(f"model {model.id} with effects ({found}) has no translation to C, expected one without effects")
    theta = model.vector(values)
    unit = _Unit({f"{prefix}_{name}" for name in ("init", "step", "state", "parameter", "parameters")})
    lag, laws, kernel = (unit.function(f) for f in (current.lagged_current, current.coefficients, model.kernel))
    return Template(_template("damper.c")).substitute(
        p=prefix,
        P=prefix.upper(),
        title=_comment(model.title),
        equation=textwrap.fill(_comment(model.equation), 100, initial_indent=" *   ", subsequent_indent=" *   "),
        source=textwrap.fill(_comment(model.source), 100, initial_indent=" * Source: ", subsequent_indent=" *   "),
        example=f"{prefix}_{model.names[0]}".upper(),
        indices="\n".join(
            f"    {f'{prefix}_{p.name}'.upper()},  /* {_comment(f'{p.unit}: {p.meaning}' if p.unit else p.meaning)} */"
            for p in model.parameters
        ),
        table="\n".join(
            f'    {{"{p.name}", "{p.unit}", {_number(value)}, {_number(p.lower)}, {_number(p.upper)}}},'
            for p, value in zip(model.parameters, theta, strict=True)
        ),
        states=2 + model.states,
        quantities=len(model.quantities),
        names=textwrap.fill(", ".join(quantity.name for quantity in model.quantities), 100, subsequent_indent="   "),
        codes=", ".join(map(str, model._codes)),
        columns=", ".join(str(index) for row in model._columns for index in row),
        floors=", ".join(map(_number, model._floors)),
        functions=unit.text,
        lag=lag.name,
        laws=laws.name,
        kernel=kernel.name,
    )


def _template(name: str) -> str:
    return resources.files("mrd_sim").joinpath("c", name).read_text(encoding="utf-8")


def _comment(text: str) -> str:
    return " ".join(text.replace("*/", "* /").split())


def _number(value: float) -> str:
    if not math.isfinite(value):
        raise InputError(f"{value} has no translation to C, expected a finite number")
    return repr(float(value))


@dataclass(frozen=True)
class _Signature:
    """A translated function.

    ``result`` is its C type, ``parts`` the length of the tuple that it returns or 0, ``arrays`` tells for each parameter
    whether it is an array, ``writes`` which of them are written to.
    """

    name: str
    result: str
    parts: int
    arrays: tuple[bool, ...]
    writes: tuple[bool, ...]


class _Unit:
    """C functions and constants, each after those that it needs."""

    def __init__(self, taken: set[str]) -> None:
        self._text: list[str] = []
        self._names = taken
        self._constants: dict[tuple[str, float], str] = {}
        self._functions: dict[Callable[..., Any], _Signature | None] = {}

    @property
    def text(self) -> str:
        return "\n".join(self._text)

    def function(self, compiled: Any) -> _Signature:
        """Translate a compiled function, once."""
        python = getattr(compiled, "py_func", compiled)
        if python not in self._functions:
            self._functions[python] = None
            translated = _Function(self, python)
            self._text.append(translated.text)
            self._functions[python] = translated.signature
        found = self._functions[python]
        if found is None:
            raise InputError(f"{python.__module__}.{python.__name__} calls itself, which has no translation to C")
        return found

    def constant(self, module: str, name: str, value: float) -> str:
        """Name of a constant of a module."""
        key = (f"{module}.{name}", value)
        if key not in self._constants:
            self._constants[key] = self.name(module, name)
            self._text.append(f"static const double {self._constants[key]} = {_number(value)};\n")
        return self._constants[key]

    def name(self, module: str, name: str) -> str:
        """A C name that is still free."""
        found = f"{module.rpartition('.')[2]}_{name.strip('_')}"
        while found in self._names:
            found += "_"
        self._names.add(found)
        return found


class _Function:
    """Translation of one function.

    Numbers are double or, where Python has integers, int. An array is a pointer; one with two indices is row after row of
    the model's coefficients or, if of integers, of the laws' columns. An array that is made and returned becomes one more
    parameter. A number with a derivative is its value.
    """

    def __init__(self, unit: _Unit, python: Callable[..., Any]) -> None:
        self.unit, self.python = unit, python
        self.module = python.__module__
        lines, self.first = inspect.getsourcelines(python)
        tree = ast.parse(textwrap.dedent("".join(lines))).body[0]
        if not isinstance(tree, ast.FunctionDef):
            raise InputError(f"{self.module}: {python.__name__} is no function, which has no translation to C")
        self.tree = tree
        nodes = sorted(ast.walk(tree), key=lambda node: (getattr(node, "lineno", 0), getattr(node, "col_offset", 0)))
        self.parameters = {arg.arg: self._kind(arg) for arg in tree.args.args}
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
        self.locals = [
            name for name in dict.fromkeys(stored) if name not in self.parameters and name not in self.made | self.counters
        ]
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
        arrays = tuple(kind.endswith("*") for kind in self.parameters.values())
        writes = tuple(parameter in self.written for parameter in self.parameters)
        self.signature = _Signature(name, self.result, parts, arrays, writes)
        self.text = self._head(parts, name) + self._declarations() + body + "}\n"

    def _head(self, parts: int, name: str) -> str:
        structure = ""
        if parts:
            structure = f"typedef struct {{ double {', '.join(f'_{i}' for i in range(parts))}; }} {self.result};\n\n"
        listed = [
            f"{kind if name in self.written or '*' not in kind else f'const {kind}'}{'' if '*' in kind else ' '}{_c(name)}"
            for name, kind in self.parameters.items()
        ]
        listed += [f"double *{_c(name)}" for name in sorted(self.made)]
        if any("*" in parameter for parameter in listed):
            listed.insert(0, "int vertices")
        words = _comment((ast.get_docstring(self.tree) or "").partition("\n\n")[0])
        comment = textwrap.fill(f"{words} ({self.module})" if words else self.module, 100, subsequent_indent="   ")
        signature = _wrapped(f"static {self.result} {name}(", listed or ["void"], ")")
        return f"{structure}/* {comment} */\n{signature}\n{{\n"

    def _declarations(self) -> str:
        text = ""
        for kind, chosen in (
            ("double", [name for name in self.locals if name not in self.integers]),
            ("int", [name for name in self.locals if name in self.integers]),
        ):
            if chosen:
                text += _wrapped(f"    {kind} ", [_c(name) for name in chosen], ";") + "\n"
        return text

    # What the names are

    def _kind(self, arg: ast.arg) -> str:
        annotation = ast.unparse(arg.annotation) if arg.annotation else ""
        kinds = {
            "float": "double",
            "Any": "double",
            "complex": "double",
            "int": "int",
            "bool": "int",
            "Array": "double *",
            "NDArray[np.intp]": "int *",
        }
        if annotation not in kinds:
            raise self._refuse(arg, f"parameter {arg.arg} of type {annotation or 'unknown'}")
        return kinds[annotation]

    def _makes_array(self, node: ast.AST) -> bool:
        return isinstance(node, ast.Call) and ast.unparse(node.func) in ("np.empty", "np.empty_like")

    def _check_loops(self, nodes: Sequence[ast.AST]) -> None:
        """Refuse what would mean something else in C: a counter or a bound that the loop changes or that outlives it."""
        for loop in nodes:
            if not isinstance(loop, ast.For):
                continue
            inside = [node for part in loop.body for node in ast.walk(part) if isinstance(node, ast.Name)]
            changed = {node.id for node in inside if isinstance(node.ctx, ast.Store)}
            fixed = {node.id for part in (loop.target, loop.iter) for node in ast.walk(part) if isinstance(node, ast.Name)}
            if changed & fixed or loop.orelse:
                raise self._refuse(loop, "a loop that changes its own counter or bounds, or has an else")
        loops = [loop for loop in nodes if isinstance(loop, ast.For) and isinstance(loop.target, ast.Name)]
        for counter in {loop.target.id for loop in loops if isinstance(loop.target, ast.Name)}:
            own = [loop for loop in loops if isinstance(loop.target, ast.Name) and loop.target.id == counter]
            within = {node for loop in own for node in ast.walk(loop)}
            for node in nodes:
                if isinstance(node, ast.Name) and node.id == counter and node not in within:
                    raise self._refuse(node, f"{counter} outside of its loop")

    def _find_integers(self, nodes: Sequence[ast.AST]) -> set[str]:
        """Local variables that only ever hold integers."""
        assigned: list[tuple[str, ast.expr | None]] = []
        for node in nodes:
            if isinstance(node, ast.Assign):
                for target in node.targets:
                    if isinstance(target, ast.Name):
                        assigned.append((target.id, node.value))
                    elif isinstance(target, ast.Tuple):
                        values = node.value.elts if isinstance(node.value, ast.Tuple) else [None] * len(target.elts)
                        assigned += [(t.id, v) for t, v in zip(target.elts, values, strict=True) if isinstance(t, ast.Name)]
            elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                assigned.append((node.target.id, node.value))
            elif isinstance(node, ast.AugAssign) and isinstance(node.target, ast.Name):
                value = ast.BinOp(ast.Name(node.target.id, ast.Load()), node.op, node.value)
                assigned.append((node.target.id, value))
        self.integers = set(self.locals)
        while True:
            real = {name for name, value in assigned if value is None or not self._is_integer(value)}
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
            case ast.Subscript(value=ast.Attribute(attr="shape")):
                return True
            case ast.Subscript(value=ast.Name(id=name)):
                return self.parameters.get(name) == "int *"
            case ast.Call(func=ast.Name(id="len")):
                return True
            case ast.Call(func=func):
                called = self._global(func)
                return hasattr(called, "py_func") and self.unit.function(called).result == "int"
        return False

    def _global(self, node: ast.expr) -> Any:
        """What a name, or an attribute of a module, stands for outside of the function."""
        match node:
            case ast.Name(id=name):
                found = self.python.__globals__.get(name, getattr(builtins, name, None))
            case ast.Attribute(value=ast.Name(id=module), attr=name):
                found = getattr(self.python.__globals__.get(module), name, None)
            case _:
                found = None
        if found is None:
            raise self._refuse(node, ast.unparse(node))
        return found

    def _refuse(self, node: ast.AST, what: str) -> InputError:
        line = self.first + getattr(node, "lineno", 1) - 1
        return InputError(f"{self.module}.{self.python.__name__}, line {line}: {what} has no translation to C")

    # Statements

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

    # Expressions: text and how tightly it binds, from 1 (?:) to 9 (a name)

    def _text(self, node: ast.expr, least: int = 0) -> str:
        text, binds = self._expression(node)
        return text if binds >= least else f"({text})"

    def _expression(self, node: ast.expr) -> tuple[str, int]:
        match node:
            case ast.Constant(value=bool() | int() as value):
                return str(int(value)), 9
            case ast.Constant(value=float() as value):
                return _number(value), 9
            case ast.Name(id=name):
                return self._name(node, name), 9
            case ast.Attribute(value=value, attr="real"):
                return self._expression(value)
            case ast.Attribute():
                return _number(self._value(node)), 9
            case ast.Subscript():
                return self._element(node), 9
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return f"pow({self._text(left)}, {self._text(right)})", 9
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
                for comparison, one, other in zip(ops, terms, comparators, strict=False):
                    if type(comparison) not in _COMPARISONS:
                        raise self._refuse(node, ast.unparse(node))
                    sign, binds = _COMPARISONS[type(comparison)]
                    parts.append(f"{self._text(one, 6)} {sign} {self._text(other, 6)}")
                return " && ".join(parts), binds if len(parts) == 1 else 3
            case ast.BoolOp(op=op, values=values) if all(map(self._is_integer, values)):
                sign, binds = (" && ", 3) if isinstance(op, ast.And) else (" || ", 2)
                return sign.join(self._text(value, 4) for value in values), binds
            case ast.IfExp(test=test, body=body, orelse=orelse):
                return f"{self._text(test, 2)} ? {self._text(body, 2)} : {self._text(orelse, 1)}", 1
            case ast.Call(func=ast.Name(id="len"), args=[ast.Name(id=name)]):
                return ("QUANTITIES" if self.parameters.get(name) == "int *" else "vertices"), 9
            case ast.Call(func=ast.Name(id="float"), args=[value]):
                return f"(double){self._text(value, 8)}", 8
            case ast.Call(keywords=[]):
                return self._call(node), 9
        raise self._refuse(node, ast.unparse(node))

    def _name(self, node: ast.expr, name: str) -> str:
        if name in self.parameters or name in self.locals or name in self.made or name in self.counters:
            return _c(name)
        value = self._value(node)
        return str(int(value)) if isinstance(value, int) else self.unit.constant(self.module, name, value)

    def _value(self, node: ast.expr) -> float:
        found = self._global(node)
        if not isinstance(found, int | float):
            raise self._refuse(node, ast.unparse(node))
        return found

    def _element(self, node: ast.Subscript) -> str:
        match node:
            case ast.Subscript(value=ast.Attribute(value=ast.Name(), attr="shape"), slice=ast.Constant(value=1)):
                return "QUANTITIES"
            case ast.Subscript(value=ast.Name(id=name), slice=ast.Tuple(elts=[row, column])) if self._is_array(name):
                width = "LAW_PARAMETERS" if self.parameters.get(name) == "int *" else "QUANTITIES"
                return f"{_c(name)}[{self._text(row, 7)} * {width} + {self._text(column, 6)}]"
            case ast.Subscript(value=ast.Name(id=name), slice=index) if self._is_array(name) and self._is_integer(index):
                return f"{_c(name)}[{self._text(index)}]"
        raise self._refuse(node, ast.unparse(node))

    def _is_array(self, name: str) -> bool:
        return name in self.made or self.parameters.get(name, "").endswith("*")

    def _call(self, node: ast.Call) -> str:
        called = self._global(node.func)
        if called in _LIBRARY:
            if called in (builtins.min, builtins.max) and len(node.args) != 2:
                raise self._refuse(node, f"{ast.unparse(node)} of other than two numbers")
            return f"{_LIBRARY[called]}({', '.join(self._text(arg) for arg in node.args)})"
        if not hasattr(called, "py_func"):
            raise self._refuse(node, ast.unparse(node))
        target = self.unit.function(called)
        if len(node.args) != len(target.arrays):
            raise self._refuse(node, f"{ast.unparse(node)} with defaults")
        given = ["vertices"] if any(target.arrays) else []
        for arg, array, written in zip(node.args, target.arrays, target.writes, strict=True):
            if array and not (isinstance(arg, ast.Name) and self._is_array(arg.id)):
                raise self._refuse(arg, f"{ast.unparse(arg)} as an array")
            if written and isinstance(arg, ast.Name):
                self.written.add(arg.id)
            given.append(self._text(arg))
        return f"{target.name}({', '.join(given)})"


def _wrapped(head: str, parts: Sequence[str], tail: str) -> str:
    """A list that breaks between its parts only."""
    whole = head + ", ".join(parts) + tail
    kept = whole.replace(" ", "\0").replace(",\0", ", ")
    indent = " " * (len(head) - len(head.lstrip()) + 4)
    return textwrap.fill(kept, 110, subsequent_indent=indent, drop_whitespace=True).replace("\0", " ")


def _names(node: ast.expr) -> set[str]:
    return {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}


def _c(name: str) -> str:
    return f"{name}_" if name in _TAKEN else name

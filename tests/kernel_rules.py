"""What a kernel may not contain, read from its source (docs/explanation/architecture.md, "Kernels")."""

from __future__ import annotations

import ast
import builtins
import re
from collections.abc import Iterator

from tests.kernel_divisions import unguarded_divisions

BUILTINS = {"abs", "float", "int", "len", "max", "min", "range"}
MATH_CONSTANTS = {"e", "inf", "nan", "pi", "tau"}
BANNED = {
    ast.Assert: "assert",
    ast.ClassDef: "class",
    ast.Dict: "dict display",
    ast.DictComp: "dict comprehension",
    ast.FunctionDef: "nested function",
    ast.GeneratorExp: "comprehension: write the loop",
    ast.Global: "global",
    ast.Import: "import",
    ast.ImportFrom: "import",
    ast.JoinedStr: "f-string",
    ast.Lambda: "lambda",
    ast.ListComp: "comprehension: write the loop",
    ast.Raise: "raise",
    ast.Set: "set display",
    ast.SetComp: "set comprehension",
    ast.Try: "try",
    ast.With: "with",
    ast.Yield: "yield",
}


def complaints_of(source: str, inside: str, maths: set[str]) -> list[str]:
    """Every banned thing in the kernels of one module; `maths` are the functions of `math` that are allowed."""
    tree = ast.parse(source)
    modules = _module_aliases(tree)
    never_zero = set(re.findall(r"^ +(\w+): [^#\n]*#[^\n]*not 0", source, re.MULTILINE))
    lines = source.splitlines()
    found = []
    for function in _kernels(tree):
        said = [*_banned(function), *_calls(function, modules, maths), *_modulos(function)]
        for line, denominator in unguarded_divisions(function, never_zero):
            if "not 0:" not in lines[line - 1]:
                said.append((line, f"division by {denominator}: guard it, or say why with '# not 0: reason'"))
        found += [f"{inside}:{line} in kernel {function.name}: {what}" for line, what in said]
    return found


def _kernels(tree: ast.Module) -> list[ast.FunctionDef]:
    """Functions decorated with @kernel, and functions of the module that they call by name, and so on."""
    by_name = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
    todo = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and _is_kernel(node)]
    seen: list[ast.FunctionDef] = []
    while todo:
        function = todo.pop()
        if function in seen:
            continue
        seen.append(function)
        called = [node.func for node in ast.walk(function) if isinstance(node, ast.Call)]
        todo += [by_name[name.id] for name in called if isinstance(name, ast.Name) and name.id in by_name]
    return sorted(seen, key=lambda function: function.lineno)


def _is_kernel(function: ast.FunctionDef) -> bool:
    return any(getattr(mark, "id", getattr(mark, "attr", "")) == "kernel" for mark in function.decorator_list)


def _module_aliases(tree: ast.Module) -> dict[str, str]:
    """Local name -> dotted origin of everything imported: 'np' -> 'numpy', 'hypot' -> 'math.hypot'."""
    aliases: dict[str, str] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            aliases.update({(name.asname or name.name).split(".")[0]: name.name for name in node.names})
        elif isinstance(node, ast.ImportFrom):
            aliases.update({name.asname or name.name: f"{node.module}.{name.name}" for name in node.names})
    return aliases


def _inner(function: ast.FunctionDef) -> Iterator[ast.AST]:
    """Every node of the body, docstring and annotations left out."""
    body = function.body[1:] if ast.get_docstring(function) is not None else function.body
    for statement in body:
        for node in ast.walk(statement):
            if not (isinstance(node, ast.Constant) and isinstance(statement, ast.AnnAssign)):
                yield node


def _banned(function: ast.FunctionDef) -> Iterator[tuple[int, str]]:
    for node in _inner(function):
        line = getattr(node, "lineno", function.lineno)
        if type(node) in BANNED:
            yield line, BANNED[type(node)]
        elif isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.Pow):
            yield line, "**: multiply out"
        elif isinstance(node, ast.List) and isinstance(node.ctx, ast.Load):
            yield line, "list display: the state owns a buffer()"
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield line, "string"
        elif isinstance(node, ast.Constant) and node.value is None:
            yield line, "None"


def _calls(function: ast.FunctionDef, modules: dict[str, str], maths: set[str]) -> Iterator[tuple[int, str]]:
    """Names and attributes that come from where they may not, and methods of values."""
    for node in _inner(function):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            yield from _name(node, modules, maths)
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            origin = modules.get(node.value.id, "")
            if origin == "math" and node.attr not in maths | MATH_CONSTANTS:
                yield node.lineno, f"math.{node.attr} is not on the list"
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            base = node.func.value
            if not (isinstance(base, ast.Name) and base.id in modules):
                yield node.lineno, f"method call .{node.func.attr}()"


def _name(node: ast.Name, modules: dict[str, str], maths: set[str]) -> Iterator[tuple[int, str]]:
    origin = modules.get(node.id, "")
    library, _, rest = origin.partition(".")
    if library == "numpy":
        yield node.lineno, f"numpy ({node.id})"
    elif library == "math" and rest and rest not in maths | MATH_CONSTANTS:
        yield node.lineno, f"math.{rest} is not on the list"
    elif library not in ("", "math", "tunefree_hil"):
        yield node.lineno, f"{origin} is no kernel"
    elif not origin and node.id in dir(builtins) and node.id not in BUILTINS:
        yield node.lineno, f"builtin {node.id}"


def _modulos(function: ast.FunctionDef) -> Iterator[tuple[int, str]]:
    whole = _whole_names(function)
    for node in _inner(function):
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mod):
            if not (_is_whole(node.left, whole) and _is_whole(node.right, whole)):
                yield node.lineno, "% on what may be a float: wrap integers in int(...)"
        elif isinstance(node, ast.AugAssign) and isinstance(node.op, ast.Mod):
            yield node.lineno, "%=: write it out"


def _whole_names(function: ast.FunctionDef) -> set[str]:
    """Local names that only ever hold integers, as far as the source shows it."""
    names = {
        argument.arg
        for argument in function.args.args
        if isinstance(argument.annotation, ast.Name) and argument.annotation.id == "int"
    }
    bound: dict[str, list[ast.expr]] = {}
    for node in _inner(function):
        if isinstance(node, ast.Assign):
            for target in node.targets:
                if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                    for name, value in zip(target.elts, node.value.elts, strict=False):
                        bound.setdefault(getattr(name, "id", ""), []).append(value)
                else:
                    bound.setdefault(getattr(target, "id", ""), []).append(node.value)
        elif isinstance(node, ast.AugAssign):
            bound.setdefault(getattr(node.target, "id", ""), []).append(node.value)
        elif isinstance(node, ast.For) and _called(node.iter) == "range":
            names.add(getattr(node.target, "id", ""))
    for _ in range(len(bound) + 1):
        names |= {name for name, values in bound.items() if all(_is_whole(value, names) for value in values)}
    return names


def _is_whole(value: ast.expr, names: set[str]) -> bool:
    if isinstance(value, ast.Constant):
        return isinstance(value.value, int)
    if isinstance(value, ast.BinOp):
        kept = isinstance(value.op, ast.Add | ast.Sub | ast.Mult | ast.FloorDiv | ast.Mod)
        return kept and _is_whole(value.left, names) and _is_whole(value.right, names)
    return _called(value) in ("int", "len") or (isinstance(value, ast.Name) and value.id in names)


def _called(node: ast.expr) -> str:
    return getattr(node.func, "id", "") if isinstance(node, ast.Call) else ""

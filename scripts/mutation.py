"""The mutants of a file: copies with one change of one expression."""

from __future__ import annotations

import ast
import copy
import gc
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import CodeType, FunctionType

COMPARISONS = {
    ast.Lt: ast.GtE,
    ast.LtE: ast.Gt,
    ast.Gt: ast.LtE,
    ast.GtE: ast.Lt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
OPERATORS = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
CALLS = {"min": "max", "max": "min", "any": "all", "all": "any", "argmin": "argmax", "argmax": "argmin"}


@dataclass(frozen=True)
class Mutant:
    """One changed expression.

    Attributes
    ----------
    path : str
        Of the file, relative to the checkout.
    line, last_line : int
        Of the change.
    source : str
        The whole file with the change.
    before, after : str
        The line with the expression, and with what stands for it.
    """

    path: str
    line: int
    last_line: int
    source: str
    before: str
    after: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}\n    - {self.before}\n    + {self.after}"


def mutants(path: str, text: str) -> list[Mutant]:
    """All mutants of a file; annotations, docstrings and messages of errors are left alone."""
    tree = ast.parse(text)
    lines = text.splitlines(keepends=True)
    found = []
    for node in _code(tree):
        for changed in _changes(node):
            start, end = node.lineno - 1, node.end_lineno or node.lineno
            head = "".join(lines[start:end]).encode()[: node.col_offset].decode()
            new = head + ast.unparse(changed) + _after(lines, node)
            source = "".join(lines[:start]) + new + "".join(lines[end:])
            if source != text:
                before = " ".join("".join(lines[start:end]).split())
                found.append(Mutant(path, node.lineno, end, source, before, " ".join(new.split())))
    return found


def _after(lines: Sequence[str], node: ast.expr) -> str:
    last = lines[(node.end_lineno or node.lineno) - 1].encode()
    return last[node.end_col_offset :].decode()


def _code(tree: ast.AST) -> Iterator[ast.expr]:
    """Expressions that compute something."""
    for child in ast.iter_child_nodes(tree):
        if isinstance(child, (ast.Raise, ast.JoinedStr, ast.arg)):
            continue
        if isinstance(child, ast.AnnAssign):
            if child.value is not None:
                yield from _code(ast.Expression(child.value))
            continue
        if isinstance(child, (ast.FunctionDef, ast.ClassDef)):
            for part in child.body:
                yield from _code(ast.Module([part], []))
            continue
        if isinstance(child, ast.expr):
            yield child
        yield from _code(child)


def _changes(node: ast.expr) -> Iterator[ast.expr]:
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in COMPARISONS:
        yield _with(node, ops=[COMPARISONS[type(node.ops[0])]()])
    elif isinstance(node, ast.BinOp) and type(node.op) in OPERATORS and not _is_text(node):
        yield _bracketed(_with(node, op=OPERATORS[type(node.op)]()))
    elif isinstance(node, ast.BoolOp):
        yield _bracketed(_with(node, op=ast.Or() if isinstance(node.op, ast.And) else ast.And()))
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield node.operand
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
        if isinstance(node.value, float) and 0 < abs(node.value) < 0.1:
            yield ast.Constant(node.value * 1e4)
        else:
            yield ast.Constant(node.value + 1)
    elif isinstance(node, ast.Call) and isinstance(node.func, (ast.Name, ast.Attribute)):
        name = node.func.id if isinstance(node.func, ast.Name) else node.func.attr
        if name in CALLS:
            key = "id" if isinstance(node.func, ast.Name) else "attr"
            yield _with(node, func=_with(node.func, **{key: CALLS[name]}))


def _with(node: ast.expr, **fields: object) -> ast.expr:
    changed = copy.deepcopy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed


def _bracketed(node: ast.expr) -> ast.expr:
    """The expression in brackets: it may stand inside another one."""
    return ast.Name(f"({ast.unparse(node)})")


def _is_text(node: ast.BinOp) -> bool:
    """Whether text is joined, or a type is stated."""
    sides = (node.left, node.right)
    return any(
        isinstance(side, ast.JoinedStr)
        or (isinstance(side, ast.Constant) and (isinstance(side.value, str) or side.value is None))
        for side in sides
    )


class NotInAFunctionError(Exception):
    """The change is in code that runs when the module is imported."""


def put_in_place(mutant: Mutant, text: str) -> None:
    """Change the functions of a module that is imported already, ``text`` being the file as it is."""
    before = compile(text, mutant.path, "exec")
    after = compile(mutant.source, mutant.path, "exec")
    changed = {(old.co_name, old.co_firstlineno): new for old, new in _changed(before, after, False)}
    functions = [
        thing
        for thing in gc.get_objects()
        if isinstance(thing, FunctionType)
        and thing.__code__.co_filename.endswith(mutant.path)
        and (thing.__code__.co_name, thing.__code__.co_firstlineno) in changed
    ]
    if not functions:
        raise NotInAFunctionError(str(mutant))
    for function in functions:
        function.__code__ = changed[function.__code__.co_name, function.__code__.co_firstlineno]


def in_a_function(mutant: Mutant, text: str) -> bool:
    """Whether the change can be put in place."""
    try:
        before, after = (compile(source, mutant.path, "exec") for source in (text, mutant.source))
        return any(True for _ in _changed(before, after, False))
    except NotInAFunctionError:
        return False


def _changed(old: CodeType, new: CodeType, in_function: bool) -> Iterator[tuple[CodeType, CodeType]]:
    """Functions that differ, each with the functions around it."""
    inner = list(zip(_functions(old), _functions(new), strict=True))
    parts = [pair for one, other in inner for pair in _changed(one, other, _is_function(one))]
    differs = (old.co_code, _values(old), old.co_names) != (new.co_code, _values(new), new.co_names)
    if differs and not in_function:
        raise NotInAFunctionError(old.co_name)
    if in_function and (differs or parts):
        yield old, new
    yield from parts


def _is_function(code: CodeType) -> bool:
    return bool(code.co_flags & 1)  # CO_OPTIMIZED, which bodies of classes do not have


def _functions(code: CodeType) -> list[CodeType]:
    return [part for part in code.co_consts if isinstance(part, CodeType)]


def _values(code: CodeType) -> list[str]:
    return [repr(part) for part in code.co_consts if not isinstance(part, CodeType)]

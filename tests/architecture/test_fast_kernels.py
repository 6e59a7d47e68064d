"""A kernel whose sums may be regrouped exists once: it is compiled into its caller.

Numba keeps a called kernel twice, in its own object code and in its caller's, and optimises each by
itself. Where sums may be regrouped (``fastmath``) the two round differently, and which of them runs
depends on what the cache holds: tracks differed by 3e-5 px between a cold and a warm cache.
"""

import ast

from stand_ins.source_trees import FILES, PACKAGE, text_of, tree_of


def compiled(tree: ast.AST) -> list[tuple[ast.FunctionDef, dict[str, ast.expr]]]:
    """Return the compiled functions of a file with the options that they are compiled with."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            for call in node.decorator_list:
                if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "njit":
                    found.append((node, {k.arg or "": k.value for k in call.keywords}))
    return found


def may_regroup(fastmath: ast.expr | None) -> bool:
    """Return whether sums may be regrouped; the set ``SAME_BITS`` allows nothing of that kind."""
    return fastmath is not None and getattr(fastmath, "id", "") != "SAME_BITS"


def test_regrouped_sums_are_compiled_into_their_callers() -> None:
    trees = {path: tree_of(path) for path in FILES if "njit" in text_of(path)}
    kernels = [(path, *kernel) for path, tree in trees.items() for kernel in compiled(tree)]
    called = {
        node.func.id
        for _, function, _ in kernels
        for node in ast.walk(function)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    }
    assert len(kernels) >= 50  # it looks at something
    regrouped = [entry for entry in kernels if may_regroup(entry[2].get("fastmath"))]
    twice = [
        f"{path.relative_to(PACKAGE)}: {function.name}"
        for path, function, options in regrouped
        if function.name in called and "forceinline" not in options
    ]
    assert twice == [], "add forceinline=True"

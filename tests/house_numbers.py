"""Numbers about the shape of the code. Run from the root: `python tests/house_numbers.py`.

Prints one line per number: import circles and folder sizes of Rust and Python, Rust type names that
are defined more than once, comments per 100 lines in the arithmetic of the core, statements, public
parameters, functions above 40 lines. `tests/python/house/test_house.py` holds some of them to their
limits. `python tests/house_numbers.py comments 50 18` prints 50 comments of the arithmetic instead,
drawn with the seed 18, for somebody to judge whether each says why.
"""

import ast
import random
import re
import sys
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path

Module = tuple[str, ...]
Imports = dict[Module, set[Module]]

ARITHMETIC = ("geometry", "estimation", "probability", "integrate", "map", "filter", "tracking")
MODULE = re.compile(
    r'^\s*(?:#\[path = "([^"]+)"\]\s*)?(?:pub(?:\([^)]*\))?\s+)?mod\s+(\w+)\s*;', re.M
)
"""Declaration of a module that has a file of its own: its stated path, its name."""
RUST_FUNCTION = re.compile(
    r"^(\s*)(?:pub(?:\([^)]*\))?\s+)?(?:const\s+|unsafe\s+|async\s+)*fn (\w+)"
)
MOST_LINES = 40
CARGO_KINDS = ("bin", "test", "bench", "example")
RUST_TYPE = re.compile(r"^\s*(?:pub(?:\([^)]*\))?\s+)?(?:struct|enum|trait|type)\s+(\w+)", re.M)


def circles_of(imports: Imports) -> list[list[Module]]:
    """Strongly connected groups of two or more modules (Tarjan), each sorted."""
    index: dict[Module, int] = {}
    low: dict[Module, int] = {}
    stack: list[Module] = []
    groups: list[list[Module]] = []

    def visit(module: Module) -> None:
        index[module] = low[module] = len(index)
        stack.append(module)
        for other in sorted(imports.get(module, ())):
            if other not in index:
                visit(other)
                low[module] = min(low[module], low[other])
            elif other in stack:
                low[module] = min(low[module], index[other])
        if low[module] == index[module]:
            at = stack.index(module)
            group = stack[at:]
            del stack[at:]
            if len(group) > 1:
                groups.append(sorted(group))

    sys.setrecursionlimit(10_000)
    for module in sorted(imports):
        if module not in index:
            visit(module)
    return groups


def folders_of(imports: Imports, is_folder: set[Module]) -> Imports:
    """The same imports between folders: a module counts as the folder that holds it.

    Modules at the top stand for themselves: they are floors of their own.
    """

    def folder(module: Module) -> Module:
        return module if module in is_folder or len(module) == 1 else module[:-1]

    between: Imports = defaultdict(set)
    for module, others in imports.items():
        between[folder(module)] |= {folder(other) for other in others} - {folder(module)}
    return dict(between)


def circles_across(imports: Imports, is_folder: set[Module]) -> list[list[Module]]:
    """Circles between folders; a folder and what lies in it may know each other."""

    def across_of(between: Imports) -> list[list[Module]]:
        across = []
        for group in circles_of(between):
            outer = min(group, key=len)
            inside = [folder for folder in group if folder != outer]
            if any(folder[: len(outer)] != outer for folder in inside):
                across.append(group)
            else:  # a folder inside and what lies in it may know each other, too
                across += across_of({folder: between[folder] & set(inside) for folder in inside})
        return across

    return across_of(folders_of(imports, is_folder))


# Rust


def without_tests(text: str) -> str:
    """Rust source up to its module of tests."""
    return re.split(r"^#\[cfg\(test\)\]\n(?:pub\([^)]*\) |pub )?mod \w+ \{", text, flags=re.M)[0]


def rust_modules(root: Path) -> dict[Module, Path]:
    """Module path of every file of a crate, files of tests left out."""
    modules = {}
    for path in sorted(root.rglob("*.rs")):
        parts = path.relative_to(root).with_suffix("").parts
        if parts[-1] == "tests":
            continue
        if parts == ("lib",):
            parts = ()
        modules[parts[:-1] if parts and parts[-1] == "mod" else parts] = path
    return modules


def use_paths(tree: str) -> Iterator[str]:
    """Single paths of a `use` tree with braces."""
    tree = tree.strip()
    opened = tree.find("{")
    if opened < 0:
        yield tree.partition(" as ")[0]
        return
    depth, start = 0, opened + 1
    for at in range(opened, len(tree)):
        depth += {"{": 1, "}": -1}.get(tree[at], 0)
        ends = (tree[at] == "," and depth == 1) or (tree[at] == "}" and depth == 0)
        if ends:
            if tree[start:at].strip():
                yield from use_paths(tree[:opened] + tree[start:at].strip())
            start = at + 1


def rust_imports(root: Path) -> Imports:
    """Which module of a crate uses which."""
    modules = rust_modules(root)
    imports: Imports = {module: set() for module in modules}
    for module, path in modules.items():
        text = re.sub(r"//.*", "", without_tests(path.read_text(encoding="utf-8")))
        for tree in re.findall(r"\buse ((?:crate|super|self)\b[^;]*);", text):
            for used in use_paths(" ".join(tree.split())):
                first, *rest = used.replace(" ", "").split("::")
                base = () if first == "crate" else module
                if first == "super":
                    base = base[:-1]
                while rest and rest[0] == "super":
                    base, rest = base[:-1], rest[1:]
                target = (*base, *rest)
                while target and target not in modules:
                    target = target[:-1]
                if target and target != module:
                    imports[module].add(target)
    return imports


def rust_targets(manifest: Path) -> Iterator[Path]:
    """Files that cargo compiles for one package: its library, programs, tests and benchmarks."""
    package = tomllib.loads(manifest.read_text(encoding="utf-8"))
    stated = [
        package.get("lib", {}),
        *(one for kind in CARGO_KINDS for one in package.get(kind, [])),
    ]
    paths = [target["path"] for target in stated if "path" in target]
    usual = [path for path in ("build.rs", "src/lib.rs", "src/main.rs") if path not in paths]
    for path in [*paths, *(path for path in usual if (manifest.parent / path).exists())]:
        yield (manifest.parent / path).resolve()


def rust_files_of_no_module(root: Path, manifests: Iterable[Path]) -> list[Path]:
    """Rust files below `root` that no target reaches through `mod`: cargo never compiles them."""
    waiting = [target for manifest in manifests for target in rust_targets(manifest)]
    heads, reached = set(waiting), set[Path]()  # modules of heads lie beside them
    while waiting:
        path = waiting.pop()
        if path in reached or not path.exists():
            continue
        reached.add(path)
        is_head = path in heads or path.name == "mod.rs"
        folder = path.parent if is_head else path.with_suffix("")
        text = re.sub(r"//.*", "", path.read_text(encoding="utf-8"))
        for stated, name in MODULE.findall(text):
            if stated:
                heads.add((path.parent / stated).resolve())
                waiting.append((path.parent / stated).resolve())
            else:
                waiting += [folder / f"{name}.rs", folder / name / "mod.rs"]
    files = {path.resolve() for path in root.rglob("*.rs")}
    return sorted(files - reached)


TYPES_OF_TRAITS = {"Output", "Item", "Error", "Target", "World", "Cv", "Wide"}
"""Every implementation of a trait defines them."""


def rust_types_defined_twice(roots: Iterable[Path]) -> list[str]:
    """Names of types that more than one place defines, tests left out."""
    names = Counter(
        name
        for root in roots
        for path in rust_modules(root).values()
        for name in RUST_TYPE.findall(without_tests(path.read_text(encoding="utf-8")))
        if name not in TYPES_OF_TRAITS
    )
    return sorted(name for name, count in names.items() if count > 1)


def rust_comments(root: Path) -> tuple[int, int]:
    """Lines with a comment that is not documentation, and all lines, in arithmetic files."""
    comments = lines = 0
    for module, path in rust_modules(root).items():
        if not set(module) & set(ARITHMETIC):
            continue
        for line in without_tests(path.read_text(encoding="utf-8")).splitlines():
            if line.lstrip().startswith(("///", "//!")) or not line.strip():
                continue
            lines += 1
            comments += "//" in line
    return comments, lines


def rust_comments_drawn(root: Path, count: int, seed: int) -> Iterator[str]:
    """Comments of arithmetic files, drawn at random, each with its place and the code around it."""
    found = []
    for module, path in rust_modules(root).items():
        if not set(module) & set(ARITHMETIC):
            continue
        lines = without_tests(path.read_text(encoding="utf-8")).splitlines()
        is_whole = [line.lstrip().startswith("//") for line in lines]
        for first, line in enumerate(lines):
            if "//" not in line or line.lstrip().startswith(("///", "//!", "#![")):
                continue
            if is_whole[first] and first and is_whole[first - 1]:
                continue  # belongs to the comment above
            last = first
            while is_whole[first] and is_whole[last + 1]:
                last += 1
            place = f"{path.relative_to(root).as_posix()}:{first + 1}"
            found.append("\n".join([place, *lines[max(first - 1, 0) : last + 2]]))
    yield from random.Random(seed).sample(found, count)


def rust_statements(roots: Iterable[Path]) -> int:
    """Semicolons and match arms outside of comments, strings and tests: nearly statements."""
    count = 0
    for root in roots:
        for path in rust_modules(root).values():
            text = without_tests(path.read_text(encoding="utf-8"))
            text = re.sub(r'//.*|"(?:\\.|[^"\\])*"', "", text)
            count += text.count(";") + text.count("=>")
    return count


def long_rust_functions(roots: Iterable[Path], *, unless: str = "no such text") -> list[str]:
    """Functions of more than `MOST_LINES` lines, as rustfmt writes them, tests left out.

    Those that contain the text `unless` are left out, too.
    """
    found = []
    for root in roots:
        for path in rust_modules(root).values():
            if path.stem.endswith("tests"):
                continue
            lines = without_tests(path.read_text(encoding="utf-8")).splitlines()
            for first, line in enumerate(lines):
                start = RUST_FUNCTION.match(line)
                if not start:
                    continue
                length = function_length(lines[first:], end=f"{start[1]}}}")
                if length > MOST_LINES and unless not in "\n".join(lines[first : first + length]):
                    found.append(f"{path.name}:{start[2]}")
    return found


def function_length(lines: list[str], end: str) -> int:
    """Lines of the function that begins here; 0 for a declaration without a body."""
    is_open = False
    for number, line in enumerate(lines, 1):
        is_open = is_open or "{" in line
        if not is_open and line.endswith(";"):
            return 0
        if line.startswith(end):
            return number
    return 0


# Python


def python_modules(package: Path) -> dict[Module, Path]:
    """Module path of every file of a package; the package itself is ()."""
    modules = {}
    for path in sorted(package.rglob("*.py")):
        parts = path.relative_to(package).with_suffix("").parts
        modules[parts[:-1] if parts[-1] == "__init__" else parts] = path
    return modules


def import_statements(tree: ast.Module) -> Iterator[ast.Import | ast.ImportFrom]:
    """Import statements of a module, also those inside functions; not those for type checkers."""
    nodes: list[ast.AST] = list(tree.body)
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield node
        elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            nodes += node.orelse
        else:
            nodes += list(ast.iter_child_nodes(node))


def python_imports(package: Path) -> Imports:
    """Which module of a package imports which, also inside functions; not for type checkers."""
    modules = python_modules(package)
    imports: Imports = {module: set() for module in modules}
    for module, path in modules.items():
        is_package = path.name == "__init__.py"
        for node in import_statements(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                named = [alias.name for alias in node.names]
            elif node.level:
                base = (package.name, *module)
                base = base[: len(base) - node.level + is_package]
                prefix = ".".join((*base, *(node.module or "").split("."))).rstrip(".")
                named = [f"{prefix}.{alias.name}" for alias in node.names]
            else:
                named = [f"{node.module}.{alias.name}" for alias in node.names]
            for name in named:
                root, *target = name.split(".")
                if root != package.name:
                    continue
                while target and tuple(target) not in modules:
                    target.pop()
                if tuple(target) != module and target:
                    imports[module].add(tuple(target))
    return imports


def python_statements(package: Path) -> int:
    """Statements of a package as the parser counts them."""
    return sum(
        isinstance(node, ast.stmt)
        for path in package.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    )


def long_python_functions(package: Path) -> list[str]:
    """Functions whose bodies have more than `MOST_LINES` lines without their docstring.

    A signature is a list of declarations: commands declare an option per line, with its help text.
    """
    return [
        f"{path.name}:{node.name}"
        for path in package.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        if lines_of_body(node) > MOST_LINES
    ]


def lines_of_body(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines of the body from its first statement to its last one, without the docstring."""
    is_documented = ast.get_docstring(function) is not None
    statements = function.body[is_documented:]
    return (statements[-1].end_lineno or 0) - statements[0].lineno + 1 if statements else 0


def public_parameters() -> int:
    """Fields of all configuration models, each model counted once."""
    from lidar_core.parameters import MODELS, model_named, models_within

    models = {model for name in MODELS for model in models_within(model_named(name))}
    return sum(len(model.model_fields) for model in models)


# Both


def files_naming(pattern: str, rust: Iterable[Path], package: Path) -> list[str]:
    """Product files that name something; items of the papers and tests are left out."""
    paths = [path for root in rust for path in rust_modules(root).values()]
    paths += [path for path in package.rglob("*.py") if "reproduce" not in path.parts]
    return [
        path.name
        for path in paths
        if re.search(pattern, without_tests(path.read_text(encoding="utf-8")))
    ]


def largest_folder(roots: Iterable[Path]) -> tuple[int, str]:
    """Largest number of source files that lie in one folder, and which folder."""
    flat = Counter(
        path.parent.as_posix()
        for root in roots
        for path in root.rglob("*")
        if path.suffix in {".rs", ".py"}
    )
    folder, files = flat.most_common(1)[0]
    return files, folder


def main(root: Path) -> None:
    """Print every number."""
    rust = [root / "rust" / crate / "src" for crate in ("lidar_core", "lidar_sim", "lidar_core_py")]
    package = root / "python" / "lidar_core"
    for name, imports, modules in (
        ("Rust core", rust_imports(rust[0]), rust_modules(rust[0])),
        ("Python", python_imports(package), python_modules(package)),
    ):
        groups = circles_of(imports)
        heads = {
            module for module, path in modules.items() if path.name in {"mod.rs", "__init__.py"}
        }
        between = circles_across(imports, heads)
        print(
            f"{name}: import circles {len(groups)},"
            f" largest {max(map(len, groups), default=0)} files; across folders {len(between)}"
        )
        for group in [*groups, *between]:
            print("   ", " ".join("/".join(module) or "(root)" for module in group))
    print(
        "largest folder: {} files in {}".format(*largest_folder([root / "rust", root / "python"]))
    )
    twice = rust_types_defined_twice(rust[:1])
    print(f"Rust type names defined more than once: {len(twice)}: {' '.join(twice)}")
    comments, lines = rust_comments(rust[0])
    print(f"comments per 100 lines in arithmetic: {100 * comments / max(lines, 1):.1f}")
    print(f"statements: Rust {rust_statements(rust)}, Python {python_statements(package)}")
    print(f"public parameters: {public_parameters()}")
    print(
        f"functions above {MOST_LINES} lines: Rust {len(long_rust_functions(rust))},"
        f" Python {len(long_python_functions(package))}"
    )
    print(
        "files that name the motion model CTRA:", *files_naming(r'\bCtra\b|"ctra"', rust, package)
    )


if __name__ == "__main__":
    if sys.argv[1:2] == ["comments"]:
        count, seed = map(int, sys.argv[2:])
        drawn = rust_comments_drawn(Path.cwd() / "rust/lidar_core/src", count, seed)
        print(*drawn, sep="\n\n")
    else:
        main(Path.cwd())

# SPDX-License-Identifier: MIT
"""Build the site: ``ENTER_SITE=1 docker/enter python3 -m demos.site [FOLDER]``.

The pages (.md) and the executed notebooks that there are, a reference from the docstrings, by
Sphinx with myst-nb, and bodies that the mouse turns, by plotly; nothing is executed. It goes to
results/site, or to FOLDER, and asks no other server for anything: it opens from the disk, too.
"""

import importlib.util
import inspect
import re
import shutil
import sys
import tempfile
from pathlib import Path

from . import bodies

ROOT = Path(__file__).resolve().parents[2]
MATHJAX = Path("/usr/share/javascript/mathjax")
# What MathJax needs for TeX on pages, its fonts as browsers of today load them.
MATHJAX_PARTS = ["extensions", "jax/element", "jax/input/TeX", "jax/output/CommonHTML"]
MATHJAX_PARTS += ["fonts/HTML-CSS/TeX/woff"]
LINK = re.compile(r"(?<=\]\()([^)\s#]+)(?=[)#])")

# Caption: pages, in the order of the menu.
MENU = {
    "Begin": ["demos/first_hour/README", "demos/recipes/README", "demos/README"],
    "Learn": ["demos/notebooks/README", "demos/documents/README"],
    "Look up": ["forms/README", "forms/solving/README", "meshes/README", "forms/operators/README"],
    "Reference": ["api/forms", "api/meshes"],
    "Believe": ["tests/README", "forms/formulas/README", "demos/validation/README"],
    "Measure": ["demos/benchmarks/README", "demos/benchmarks/peers/README"],
    "Take part": ["docker/README", "CONTRIBUTING", "CODE_OF_CONDUCT", "CHANGELOG"],
}

SETTINGS = {
    "project": "variform",
    "html_title": "variform",
    "html_theme": "furo",
    "html_copy_source": False,
    "html_show_copyright": False,
    "extensions": ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"],
    "root_doc": "index",
    "highlight_language": "none",
    "nb_execution_mode": "off",
    "myst_enable_extensions": ["dollarmath"],
    "myst_heading_anchors": 6,
    "myst_update_mathjax": False,
    "mathjax_path": "mathjax/MathJax.js",
    "mathjax2_config": {
        "jax": ["input/TeX", "output/CommonHTML"],
        "extensions": ["tex2jax.js", "TeX/AMSmath.js", "TeX/AMSsymbols.js"],
        "tex2jax": {"processClass": "math|output_area", "ignoreClass": "content|tex2jax_ignore"},
        "showMathMenu": False,
    },
    "autodoc_member_order": "bysource",
    "python_maximum_signature_line_length": 88,
    "napoleon_use_ivar": True,
}


def copy_pages(folder):
    """Copy the pages of the menu and the notebooks, with the pictures and files they link to.

    A link to a file that is no page becomes a download (Sphinx's doing); the README is the index.
    """
    pages = [ROOT / f"{name}.md" for names in MENU.values() for name in names]
    pages = [ROOT / "README.md", *(page for page in pages if page.parent.name != "api")]
    notebooks = sorted((ROOT / "demos" / "notebooks").glob("[0-9]*.ipynb"))
    for page in pages:
        text, here = page.read_text(), page.parent
        for path in LINK.findall(text):
            target = (here / path).resolve()
            if ":" not in path and target.is_file() and target not in (*pages, *notebooks):
                copy(target, folder)
        index = f"{'../' * len(here.relative_to(ROOT).parts)}index.md"
        for path in set(LINK.findall(text)):
            if (here / path).resolve() == ROOT / "README.md":
                text = text.replace(f"]({path}", f"]({index}")
        text = bodies.with_frames(text) if page == ROOT / "demos" / "README.md" else text
        copy(page, folder).write_text(text)
    for notebook in notebooks:
        copy(notebook, folder)
    (folder / "README.md").rename(folder / "index.md")
    with (folder / "index.md").open("a") as index:
        index.writelines(toctree(caption, names) for caption, names in MENU.items())
    with (folder / "demos/notebooks/README.md").open("a") as index:
        index.write(toctree("", [notebook.stem for notebook in notebooks]))


def copy(file, folder):
    """Copy a file of the repository to its place below the folder."""
    place = folder / file.relative_to(ROOT)
    place.parent.mkdir(parents=True, exist_ok=True)
    return Path(shutil.copyfile(file, place))


def toctree(caption, names):
    """A part of the menu, which is not shown on the page itself."""
    options = ":hidden:\n" + (f":caption: {caption}\n" if caption else "")
    return f"\n```{{toctree}}\n{options}\n" + "\n".join(names) + "\n```\n"


def write_reference(folder):
    """Pages of variform.forms, of each public module in it, and of variform.meshes."""
    from variform import forms, meshes

    (folder / "api").mkdir()
    inner = {name: getattr(forms, name) for name in forms.__all__}
    inner = {name: module for name, module in inner.items() if inspect.ismodule(module)}
    for name, module in {"forms": forms, "meshes": meshes, **inner}.items():
        title = module.__name__.removeprefix("variform.")
        lines = [title, "=" * len(title), "", f".. automodule:: {module.__name__}"]
        # Energies in singular values are objects, which :members: takes for numbers.
        public = getattr(module, "__all__", ())
        lines += [""] if public else ["   :members:", ""]
        for word in public:
            item = getattr(module, word)
            if inspect.isclass(item):
                lines += [f".. autoclass:: {module.__name__}.{word}", "   :members:", ""]
            elif not inspect.ismodule(item):
                lines += [f".. autofunction:: {module.__name__}.{word}", ""]
        if name == "forms":
            lines += [".. toctree::", "", *(f"   {module}" for module in inner)]
        (folder / "api" / f"{name}.rst").write_text("\n".join(lines) + "\n")


ITEM = re.compile(r"( {4}[*\w., ]+(?:\([^)]*\))?: )(.*)")
MARKUP = re.compile(r"(``.+?``|:\w+:`[^`]+`)", re.DOTALL)


def literal(app, what, name, obj, options, lines):
    """Docstrings are to be read in a terminal: their formulas stay as they stand there.

    A paragraph that is a formula becomes a literal block; elsewhere what reStructuredText would
    take for markup is escaped. What is returned is no name of a type, as napoleon has it.
    """
    text = inspect.cleandoc("\n".join(lines))
    lines.clear()
    for paragraph in re.split(r"\n{2,}", text):
        if formula(paragraph):
            lines += ["::", "", *("    " + line for line in paragraph.split("\n")), ""]
        elif head := re.match(r"(Returns|Yields):\n", paragraph):
            rows = [escaped(row) for row in paragraph[head.end() :].split("\n")]
            lines += [f":returns: {rows[0].strip()}", *rows[1:], ""]
        elif re.match(r"(Args|Raises|Attributes):\n", paragraph):
            for row in paragraph.split("\n"):
                item = ITEM.fullmatch(row)
                lines.append(item[1] + escaped(item[2]) if item else escaped(row))
            lines.append("")
        else:  # rows further in, as those of a table of names, become a list
            rows = re.sub(r"\n {4}(?! )", "\n\n- ", escaped(paragraph))
            lines += [*re.sub(r"\n {4,}", "\n  ", rows).split("\n"), ""]


def formula(paragraph):
    """Whether a paragraph is one: it has an equals sign, and nowhere four words on end."""
    words = re.search(r"(?:\b[a-z]{2,},? ){3}[a-z]{2,}\b", paragraph)
    section = re.match(r"(Args|Returns|Raises|Attributes|Yields|Source):", paragraph)
    return "=" in paragraph and "`" not in paragraph and not words and not section


def escaped(text):
    """Text of a docstring with nothing in it that reStructuredText would read as markup."""
    parts = MARKUP.split(text)
    parts[::2] = [re.sub(r"([\\*|`_])", r"\\\1", part) for part in parts[::2]]
    return "".join(parts)


def shortened(app, what, name, obj, options, signature, returned):
    """A signature with ArrayLike by its name, and not by the dozen of types that it stands for."""
    from numpy.typing import ArrayLike
    from sphinx.util.typing import stringify_annotation

    long = stringify_annotation(ArrayLike, "smart")
    return [text and text.replace(long, "ArrayLike") for text in (signature, returned)]


def elsewhere(app, env, node, contnode):
    """A role that names something by its place in the house leads to where it is documented."""
    if node.get("refdomain") != "py":
        return None
    from sphinx.util.nodes import make_refnode

    last, objects = node["reftarget"].rpartition(".")[2], env.domains["py"].objects
    found = [name for name in objects if name.rpartition(".")[2] == last]
    if not found:
        return None
    entry = objects[min(found, key=len)]
    return make_refnode(app.builder, node["refdoc"], entry.docname, entry.node_id, contnode)


def build(folder, warnings):
    """Write the site to a folder; warnings go to a stream. Returns Sphinx's status."""
    from sphinx.application import Sphinx

    with tempfile.TemporaryDirectory() as scratch:
        source, static = Path(scratch, "source"), Path(scratch, "static")
        source.mkdir()
        copy_pages(source)
        write_reference(source)
        for part in MATHJAX_PARTS:
            shutil.copytree(MATHJAX / part, static / "mathjax" / part)
        shutil.copy(MATHJAX / "MathJax.js", static / "mathjax")
        bodies.write(Path(scratch, "extra", "demos", "figures"))
        settings = {**SETTINGS, "html_static_path": [str(static)]}
        settings["html_extra_path"] = [str(Path(scratch, "extra"))]
        app = Sphinx(source, None, folder, Path(scratch, "trees"), "html", settings, None, warnings)
        app.connect("autodoc-process-docstring", literal, priority=400)
        app.connect("autodoc-process-signature", shortened)
        app.connect("missing-reference", elsewhere)
        app.build()
    one_script(folder)
    return app.statuscode


def one_script(folder):
    """Join the theme's two: Debian's imports in vain, and from the disk none is imported."""
    theme, part = (folder / "_static" / "scripts" / f"{n}.js" for n in ("furo", "gumshoe-patched"))
    code = re.sub(r"^import .*$", "", theme.read_text(), flags=re.MULTILINE)
    theme.write_text(f"{part.read_text()}\n(() => {{{code}}})();\n")
    for page in folder.glob("**/*.html"):
        page.write_text(page.read_text().replace('<script type="module"', "<script defer"))


def main(words):
    """Build it, and say where it is."""
    if len(words) > 1 or any(word.startswith("-") for word in words):
        print(f"One folder is all that can be given, not {' '.join(words)}.")
        return 2
    needed = ("sphinx", "myst_nb", "furo", "plotly")
    absent = [name for name in needed if not importlib.util.find_spec(name)]
    absent += [] if MATHJAX.is_dir() else ["MathJax"]
    if absent:
        print(f"The site needs {', '.join(absent)}: ENTER_SITE=1 docker/enter brings them.")
        return 1
    folder = Path(words[0] if words else "results/site").resolve()
    old, mark = list(folder.iterdir()) if folder.is_dir() else [], folder / ".nojekyll"
    if old and mark not in old:
        print(f"{folder} has something else in it than a site: name another folder.")
        return 2
    for file in old:
        shutil.rmtree(file) if file.is_dir() else file.unlink()
    folder.mkdir(parents=True, exist_ok=True)
    mark.touch()  # for GitHub, whose Jekyll would leave out _static; and for the next call
    status = build(folder, sys.stderr)
    print(f"{folder / 'index.html'}: {len(list(folder.glob('**/*.html')))} pages")
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

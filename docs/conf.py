"""Settings of Sphinx: `make docs`, and rosdoc2."""

import shutil
import sys
from pathlib import Path

import tendon_robot_ros

HERE = Path(__file__).resolve().parent
# rosdoc2 builds a copy of this folder; the package then lies where it is imported from
ROOT = next(
    folder
    for folder in (HERE.parent, Path(tendon_robot_ros.__file__).parents[1])
    if (folder / 'package.xml').is_file()
)
sys.path.insert(0, str(ROOT / 'tools'))

import reference_pages  # noqa: E402

project = 'tendon_robot_ros'
author = copyright = 'The tendon_robot_ros authors'
release = (ROOT / 'package.xml').read_text().split('<version>')[1].split('<')[0]
root_doc = 'README'
extensions = ['myst_parser', 'numpydoc', 'sphinx.ext.autodoc', 'sphinx.ext.autosummary']
html_theme = 'furo'
html_title = f'{project} {release}'
myst_heading_anchors = 4
numpydoc_show_class_members = False  # the template of a class lists them with their text
templates_path = ['_templates']
default_role = 'code'  # one backtick in a docstring
autodoc_typehints = 'none'  # the docstrings say type, shape and unit


def read(app, docname, source):
    """Lead the links of a page to where things are in the site; give the index its contents."""
    if '/' not in docname:
        source[0] = reference_pages.relinked(source[0], f'docs/{docname}.md')
    if docname == root_doc:
        source[0] = reference_pages.contents(source[0])


def finished(app, error):
    """Open the index where a browser looks for it."""
    if error is None and app.builder.name == 'html':
        shutil.copy(Path(app.outdir, f'{root_doc}.html'), Path(app.outdir, 'index.html'))


def setup(app):
    """Write the pages that are made from the code, before Sphinx looks for pages."""
    reference_pages.write()
    app.connect('source-read', read)
    app.connect('build-finished', finished)

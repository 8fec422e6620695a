"""Links on the pages lead to files and to headings, and every page can be reached."""

import re
from pathlib import Path

import pytest
from documents import PAGES, text_of
from source_tree import ROOT, files

LINK = re.compile(r'!?\[[^\]]*\]\(([^)\s]+)\)')
FENCED = re.compile(r'^```.*?^```$', re.M | re.S)


def headings(page):
    """Return the anchors of a page as GitHub makes them."""
    found = []
    for line in re.findall(r'^#+ (.+)$', FENCED.sub('', text_of(page)), re.M):
        shown = re.sub(r'\[([^\]]*)\]\([^)]*\)', r'\1', line).lower()
        anchor = re.sub(r'[^\w\- ]', '', shown).replace(' ', '-')
        found.append(f'{anchor}-{found.count(anchor)}' if anchor in found else anchor)
    return found


def links(page):
    """Yield (file, anchor) of every link of a page to this repository, as written in it."""
    for target in LINK.findall(FENCED.sub('', text_of(page))):
        if not re.match(r'[a-z]+:', target):
            name, _, anchor = target.partition('#')
            yield (page.parent / name if name else page), anchor


@pytest.mark.parametrize('page', PAGES, ids=str)
def test_links_lead_to_files_and_headings(page):
    wrong = []
    for path, anchor in links(page):
        if not (ROOT / path).exists():
            wrong.append(f'{path}: no such file')
        elif anchor and anchor not in headings(path):
            wrong.append(f'{path}: no heading #{anchor}; there: {", ".join(headings(path))}')
    assert not wrong, f'{page}\n' + '\n'.join(wrong)


def test_every_page_and_picture_can_be_reached_from_the_readme():
    reached, todo = set(), [Path('README.md')]
    while todo:
        page = todo.pop()
        if page in reached or not (ROOT / page).exists():
            continue
        reached.add(page)
        if page.suffix == '.md':
            todo += [Path(*_plain(path)) for path, _ in links(page)]
    wanted = {*files('docs/*.md'), *files('docs/images/*'), *files('data/*.md')}
    left = {page for page in wanted if not {page, page.parent} & reached}
    assert sorted(map(str, left)) == []


def test_the_index_lists_every_page():
    linked = {Path(*_plain(path)) for path, _ in links(Path('docs/README.md'))}
    assert sorted(map(str, set(files('docs/*.md')) - linked - {Path('docs/README.md')})) == []


def test_anchors_are_made_as_github_does():
    assert headings(Path('docs/getting_started.md'))[2] == 'way-1-a-mock-arm'


def _plain(path):
    """Resolve the `..` in a relative path."""
    parts = []
    for part in path.parts:
        if part == '..':
            parts.pop()
        else:
            parts.append(part)
    return parts

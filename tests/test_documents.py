"""Links between the pages of this repository lead somewhere."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from gray_box_observer.context_nodes import Verdict
from gray_box_observer.context_nodes.estimate import COUNTS_AS_KNOWN
from gray_box_observer.report.run.verdict_words import look_of

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted([*ROOT.glob('*.md'), *(ROOT / 'docs').glob('*.md')])
LINK = re.compile(r'\[[^]]*\]\(([^)\s]+)\)')


def anchors(page: Path) -> set[str]:
    """What headings of a page are called in a link."""
    headings = re.findall(r'^#+ (.+)$', page.read_text(encoding='utf-8'), re.MULTILINE)
    return {
        re.sub(r'[^\w\- ]', '', heading).strip().lower().replace(' ', '-') for heading in headings
    }


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_every_link_within_the_repository_leads_somewhere(page: Path):
    for link in LINK.findall(page.read_text(encoding='utf-8')):
        if '://' in link:
            continue
        target, _, anchor = link.partition('#')
        path = (page.parent / target).resolve() if target else page
        assert path.exists(), f'{page.name}: {link}'
        assert not anchor or anchor in anchors(path), f'{page.name}: {link}'


def test_every_page_can_be_reached_from_the_readme():
    reached, waiting = set(), [ROOT / 'README.md']
    while waiting:
        page = waiting.pop()
        if page in reached or page.suffix != '.md':
            continue
        reached.add(page)
        links = [
            link.partition('#')[0]
            for link in LINK.findall(page.read_text(encoding='utf-8'))
            if '://' not in link
        ]
        waiting += [(page.parent / link).resolve() for link in links if link]
    assert set(PAGES) <= reached


def test_the_readme_can_be_read_at_one_sitting():
    assert len((ROOT / 'README.md').read_text(encoding='utf-8').split()) <= 1000


@pytest.mark.parametrize('verdict', Verdict, ids=lambda verdict: verdict.value)
def test_readme_and_report_say_the_same_of_a_verdict(verdict: Verdict):
    text = (ROOT / 'README.md').read_text(encoding='utf-8')
    meaning = re.search(rf'^\| `{verdict.value}` \| (.+) \|$', text, re.MULTILINE).group(1)
    for fit in ('ok', 'warning'):
        assert look_of(verdict.value, fit).meaning in meaning


def test_readme_and_api_say_the_same_of_what_counts_as_identified():
    words = ' or '.join(f'`{verdict.value}`' for verdict in COUNTS_AS_KNOWN)
    for page in ('README.md', 'docs/API.md'):
        text = (ROOT / page).read_text(encoding='utf-8')
        assert re.search(rf'[Tt]rue while every verdict(, or that one,)? is {words}', text), page

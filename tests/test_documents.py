"""Links between the pages of this repository lead somewhere; sentences are short."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from gray_box_observer.context_nodes import Verdict
from gray_box_observer.context_nodes.estimate import COUNTS_AS_KNOWN
from gray_box_observer.report.run.verdict_words import look_of

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted([*ROOT.glob('*.md'), *(ROOT / 'docs').glob('*.md'), ROOT / 'examples/README.md'])
READ_FIRST = (
    *('README.md', 'CHANGELOG.md', 'CONTRIBUTING.md', 'examples/README.md', 'docs/TUTORIAL.md'),
    *('docs/ROBOTS.md', 'docs/WATCHING.md', 'docs/RESULTS.md', 'docs/OPERATION.md'),
    *('docs/GLOSSARY.md', 'docs/HOSTS.md', 'docs/ARCHIVES.md'),
)
"""Pages that a user reads, whose sentences are short."""

MOST_WORDS = 25
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


def sentences(text: str) -> list[str]:
    """Return the sentences of a page: without code, headings and rows of figures."""
    text = re.sub(r'<!--.*?-->', '', text, flags=re.DOTALL)
    blocks: list[str] = ['']
    for line in text.splitlines():
        words = line.strip()
        if line.startswith('    ') and not blocks[-1]:
            continue  # code
        begins_anew = re.match(r'([*-]|\d+\.|>) ', words) or words.startswith('|')
        if not words or words.startswith('#') or begins_anew:
            blocks.append('')
        cells = re.split(r'(?<!\\)\|', words) if words.startswith('|') else [words]
        if words and not words.startswith('#'):
            blocks[-1] += f' {cells[0]}'
            blocks += cells[1:]
    found = []
    for block in blocks:
        plain = re.sub(r'`[^`]*`', 'CODE', block)
        plain = re.sub(r'!?\[([^]]*)\]\([^)]*\)', r'\1', plain).replace('*', '')
        found += re.split(r'(?<=[.!?])["”)]?\s+(?=["“(]?[A-Z0-9])', plain)
    return found


@pytest.mark.parametrize('page', READ_FIRST)
def test_sentences_are_short(page: str):
    text = (ROOT / page).read_text(encoding='utf-8')
    counts = {one: sum(bool(re.search(r'\w', w)) for w in one.split()) for one in sentences(text)}
    assert {one: count for one, count in counts.items() if count > MOST_WORDS} == {}


def test_a_long_sentence_is_found_and_code_is_none():
    long = ' '.join(['word'] * 26)
    found = [one for one in sentences(f'# T\n\n{long}. So.\n\n    {long}\n') if 'word' in one]
    assert len(found) == 1


def test_every_page_can_be_reached_from_the_readme():
    reached = set()
    waiting = [ROOT / 'README.md']
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

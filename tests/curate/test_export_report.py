import re
from html.parser import HTMLParser

import pytest

from jiti.curate.report import report_on
from jiti.curate.report.facts import gather
from jiti.errors import UsageError
from tests.builders.curate import ITC, curated, mark, propose, put, write_picks
from tests.builders.labels import segment

MARKS = [[(5, 14, 1)], [(5, 14, 1), (20, 29, 0)], [(5, 14, 1)]]


@pytest.fixture
def dataset(tmp_path):
    demos = write_picks(tmp_path / "demos", MARKS, instruction="pick <b>&amp; place")
    mark(demos, "pick_0", [(7, 16, 1)], annotator="ben")
    curated(demos, out=tmp_path / "d", gamma=0.5)
    return tmp_path / "d"


class _Balance(HTMLParser):
    """Fails on a tag that is closed without being open, or the other way round."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag, attrs):
        if tag not in ("meta", "br", "rect", "line"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag not in ("rect", "line"):
            assert self.open.pop() == tag


def test_the_page_needs_nothing_else_and_runs_nothing(dataset):
    html = report_on(dataset).read_text()
    assert not re.search(r"<script|\bsrc=|\bhref=|url\(|@import", html)
    balance = _Balance()
    balance.feed(html)
    assert balance.open == []


def test_the_page_tells_the_figures(dataset):
    facts = gather(dataset)
    assert [(e.frames, e.elegant, e.annotated) for e in facts.episodes] == [
        (30, True, 12),
        (36, False, 20),
        (42, True, 10),
    ]
    assert facts.episodes[0].peak_return == pytest.approx(2 - 2**-11)
    assert facts.verdicts == {"generic/pose_alignment": {1: 4, 0: 1}}
    assert sorted(facts.lengths[1]) == [10, 10, 10, 10]
    (agreement,) = facts.agreements
    assert (agreement.a, agreement.b, len(agreement.episodes)) == ("ann", "ben", 1)
    html = report_on(dataset).read_text()
    for told in ("67%", "elegant: 2 of 3 judged", "80% (4 / 1)", "ann, ben", "discount 0.5"):
        assert told in html, told


def test_what_was_annotated_since_and_does_not_count_is_left_out(dataset):
    before = gather(dataset)
    undecided = segment(2, 4, None, episode_id="episode_000000", itc_id=ITC)
    refused = segment(18, 19, 0, episode_id="episode_000000", itc_id=ITC, status="rejected")
    put(dataset, "episode_000000", [undecided, refused], annotator="cat")
    propose(dataset, "episode_000001", [(1, 3, 0)])
    facts = gather(dataset)
    assert facts.verdicts == before.verdicts
    assert facts.lengths == before.lengths
    assert [(one.a, one.b) for one in facts.agreements] == [("ann", "ben")]
    mark(dataset, "episode_000001", [(31, 33, 0)], annotator="dora")
    assert gather(dataset).lengths == {1: before.lengths[1], 0: [*before.lengths[0], 3]}
    assert report_on(dataset).is_file()


def test_suspects_are_listed(tmp_path):
    demos = write_picks(tmp_path / "demos", [[(5, 8, 1)], [(5, 14, 1)]])
    curated(demos, out=tmp_path / "d")
    html = report_on(tmp_path / "d").read_text()
    assert "too short" in html
    assert "episode_000000, frame 5" in html


def test_a_dataset_without_labels_has_a_page(tmp_path):
    demos = write_picks(tmp_path / "demos", [None])
    curated(demos, out=tmp_path / "d", unlabelled="keep")
    assert "0 of 0 judged" in report_on(tmp_path / "d").read_text()


def test_only_curated_datasets_have_one(tmp_path):
    with pytest.raises(UsageError, match="there is no such folder"):
        report_on(tmp_path / "nowhere")
    with pytest.raises(UsageError, match="is no dataset of jiti curate"):
        report_on(tmp_path)

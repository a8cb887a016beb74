import re
from html.parser import HTMLParser

import numpy as np
import pytest

from jiti.curate.report import report_on
from jiti.curate.report.axes import round_ticks
from jiti.curate.report.facts import gather
from jiti.curate.report.svg import histogram
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


def test_tasks_have_their_instruction_and_suspects_say_what_was_looked_for(dataset):
    html = report_on(dataset).read_text()
    assert "<td>pick &lt;b&gt;&amp;amp; place</td>" in html
    assert "Looked for: " in html


def test_robot_and_scene_are_mapped_with_axes_and_shades(tmp_path):
    demos = write_picks(tmp_path / "demos", MARKS)
    streams = {"observation.state": "/joint_states", "observation.environment_state": "/action", "action": "/action"}
    mapping = "".join(f'[features."{key}"]\nstreams = ["{stream}"]\n' for key, stream in streams.items())
    (tmp_path / "features.toml").write_text(mapping)
    curated(demos, out=tmp_path / "d", features=tmp_path / "features.toml")
    facts = gather(tmp_path / "d")
    assert [*facts.states] == ["observation.state", "observation.environment_state"]
    assert all(len(values) == len(facts.state_episode) for values in facts.states.values())
    html = report_on(tmp_path / "d").read_text()
    for told in ("<code>observation.environment_state</code>", "second component", "frames in a cell:"):
        assert told in html, told


@pytest.mark.parametrize(
    ("low", "high", "whole", "ticks"),
    [
        (8.1, 15.05, False, [10, 12, 14]),
        (23.5, 26.5, True, [24, 25, 26]),
        (0, 1, False, [0, 0.2, 0.4, 0.6, 0.8, 1]),
        (-0.13, 0.21, False, [-0.1, 0, 0.1, 0.2]),
        (0, 320, True, [0, 100, 200, 300]),
        (7, 7, False, [7]),
    ],
)
def test_ticks_are_round_numbers(low, high, whole, ticks):
    assert round_ticks(low, high, 4 if high == 320 else 5, whole=whole) == ticks


def test_equal_lengths_have_one_bar_in_the_middle():
    drawn = histogram([("satisfied", np.full(3, 25))], unit="frames")
    assert re.findall(r'text-anchor="middle">([^<]+)<', drawn) == ["24", "25", "26", "frames"]
    assert drawn.count("<rect") == 1


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

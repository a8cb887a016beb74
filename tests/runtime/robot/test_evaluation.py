"""An evaluation that a person judges: nobody knows the order, each key is kept at once, and it goes on another day."""

import re
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jiti.annotate.labels import read_segments
from jiti.errors import SourceError, UsageError
from jiti.runtime.guidance import Guidance
from jiti.runtime.robot.evaluation.evaluation import Evaluation
from jiti.runtime.robot.evaluation.judged import FILE, Judged, open_kept, read_kept
from jiti.runtime.robot.evaluation.report import EvaluationReport
from jiti.runtime.robot.evaluation.schedule import schedule
from jiti.runtime.robot.panel import Panel, Shown
from jiti.runtime.robot.request import RobotRequest, shared_of
from jiti.runtime.robot.run import Recorded
from jiti.runtime.robot.settings import RobotSettings
from jiti.runtime.robot.stops import Stopped, Stops
from jiti.tasks.catalogue import load_catalogue
from tests.builders.arm_recording import write_arm_recording

TASK = load_catalogue().task("so100/T5")
ITC = TASK.itcs[0].itc_id
GUIDANCES = {"none": Guidance("none"), "jiti": Guidance("jiti", tau=0.5)}
SETTINGS = {"task": "so100/T5", "guidances": ["jiti", "none"], "seconds": 30.0}


class Person(Panel):
    """Presses these keys; `*` is Space."""

    def __init__(self, keys: str) -> None:
        super().__init__(Stops(keys=False), print, lambda _shown: None)
        self.keys, self.asked = list(keys), []

    def ask(self, shown: Shown) -> str:
        self.asked.append(shown)
        key = self.keys.pop(0)
        if key == "*":
            raise Stopped("stopped by Space", 0)
        assert key in shown.keys, f"{key!r} is not offered at {shown.text!r}"
        return key


def evaluation(folder: Path, person: Panel, layouts: int = 2, *, blind: bool = True) -> Evaluation:
    kept = open_kept(folder, SETTINGS, len(GUIDANCES) * layouts)
    return Evaluation(kept, TASK, GUIDANCES, "ana", person, blind=blind)


def play(one: Evaluation) -> None:
    for turn in one.turns():
        one.before(turn)
        write_arm_recording(turn.path)
        one.keep(Recorded(turn, "time"))
        one.after(Recorded(turn, "time"))


@given(st.integers(0, 2**63 - 1), st.integers(1, 12), st.integers(0, 6))
def test_every_layout_is_played_by_each_guidance_and_more_layouts_change_nothing_before(salt, layouts, more):
    labels = ["none", "jiti", "full"]
    slots = schedule(labels, layouts, salt)
    assert [slot.number for slot in slots] == list(range(3 * layouts))
    assert Counter((s.layout, s.label) for s in slots) == Counter((k, name) for k in range(layouts) for name in labels)
    assert schedule(labels, layouts + more, salt)[: len(slots)] == slots


def test_the_order_is_another_in_every_evaluation():
    orders = {tuple(slot.label for slot in schedule([*GUIDANCES], 20, salt)) for salt in range(50)}
    assert len(orders) == 50
    firsts = Counter(schedule([*GUIDANCES], 1, salt)[0].label for salt in range(400))
    assert 150 < firsts["none"] < 250


def test_what_is_judged_becomes_rows_and_labels_of_a_person(tmp_path):
    one = evaluation(tmp_path, Person("\nyy\nyn\nny\nys"))
    play(one)
    kept = read_kept(tmp_path / FILE)
    assert kept.whole
    assert [(row.success, row.itcs[ITC]) for row in kept.rows] == [
        (True, True),
        (True, False),
        (False, True),
        (True, None),
    ]
    assert [row.elegant for row in kept.rows] == [True, False, False, False]
    assert {row.annotator for row in kept.rows} == {"ana"}
    segments = _segments(tmp_path)
    assert [(row["episode_id"][-1], row["reward"]) for row in segments] == [("0", 1), ("1", 0), ("2", 1)]
    assert {(row["source"], row["status"], row["itc_id"], row["annotator"]) for row in segments} == {
        ("human", "accepted", ITC, "ana")
    }
    assert all(0 <= row["start_frame"] <= row["end_frame"] < 60 for row in segments)


def test_u_goes_back_a_question_and_between_episodes_judges_the_last_one_again(tmp_path):
    person = Person("\n" + "yuny" + "u" + "yn" + "\n" + "yy")
    one = evaluation(tmp_path, person, layouts=1)
    play(one)
    first, second = read_kept(tmp_path / FILE).rows
    assert (first.success, first.itcs[ITC]) == (True, False), "judged again"
    assert (second.success, second.itcs[ITC]) == (True, True)
    assert [row["reward"] for row in _segments(tmp_path)] == [0, 1], "the earlier verdict is replaced"
    assert "u" not in person.asked[0].keys, "there is nothing to judge again before the first episode"


def test_the_last_verdict_can_be_changed_before_all_is_told(tmp_path):
    one = evaluation(tmp_path, Person("\nyy\nyn" + "u" + "ny" + "\n"), layouts=1)
    play(one)
    one.finish()
    assert [row.success for row in read_kept(tmp_path / FILE).rows] == [True, False]


def test_a_shorter_plan_goes_on_with_the_longer_one_that_it_was_begun_with(tmp_path):
    with pytest.raises(Stopped):
        play(evaluation(tmp_path, Person("\nyy*"), layouts=3))
    one = evaluation(tmp_path, Person("\nyy" * 5), layouts=1)
    play(one)
    assert len(one.kept.rows) == 6
    assert one.kept.whole


def test_space_while_judging_loses_no_episode_and_the_next_run_asks_first(tmp_path):
    with pytest.raises(Stopped):
        play(evaluation(tmp_path, Person("\nyy\ny*")))
    person = Person("nn" + "\nyy\nyy")
    one = evaluation(tmp_path, person)
    one.judge_waiting()
    assert person.asked[0].title == "Episode 2 of 4"
    play(one)
    assert [row.success for row in read_kept(tmp_path / FILE).rows] == [True, False, True, True]
    assert evaluation(tmp_path, Person("")).turns() == []


def test_an_episode_that_was_stopped_is_played_again_and_its_recording_stays(tmp_path):
    one = evaluation(tmp_path, Person(""))
    stopped = write_arm_recording(one.turns()[0].path)
    again = evaluation(tmp_path, Person("\nyy")).turns()[0].path
    assert again.name == f"{stopped.stem}-again2.mcap"
    assert stopped.exists()


def test_nothing_tells_the_guidance_before_all_is_judged(tmp_path, capsys):
    person = Person("\nyy\nyy\nyy*")
    with pytest.raises(Stopped):
        play(evaluation(tmp_path, person))
    kept = read_kept(tmp_path / FILE)
    EvaluationReport(kept, blind=True).print()
    told = capsys.readouterr().out + str(EvaluationReport(kept, blind=True).to_dict()) + str(person.asked)
    told += "".join(path.name for path in (tmp_path / "judged").rglob("*"))
    assert "jiti" not in told.replace(".jiti", "").replace("jiti annotate", "")
    assert "3 of 4 episodes are judged" in told
    assert re.search("jiti|none", evaluation(tmp_path, person, blind=False).title(0))
    assert EvaluationReport(kept, blind=False).to_dict()["methods"]


def test_the_report_has_rates_with_intervals_by_task_and_guidance(tmp_path, capsys):
    def row(number: int, layout: int, guidance: str, *, elegant: bool) -> Judged:
        return Judged(number, "so100/T5", layout, guidance, "r.mcap", "time", 1, True, {ITC: elegant}, "ana", 2)

    kept = open_kept(tmp_path / "so100-T5", SETTINGS, 40)
    (tmp_path / "so100-T5").mkdir()
    for layout in range(20):
        kept = kept.with_row(row(2 * layout, layout, "none", elegant=layout < 6))
        kept = kept.with_row(row(2 * layout + 1, layout, "jiti", elegant=layout < 15))
    other = open_kept(tmp_path / "so100-T4", {**SETTINGS, "task": "so100/T4"}, 1)
    (tmp_path / "so100-T4").mkdir()
    other.with_row(row(0, 0, "none", elegant=True))
    again = open_kept(tmp_path / "again", SETTINGS, 1)
    (tmp_path / "again").mkdir()
    again.with_row(row(0, 0, "none", elegant=True))
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / FILE).write_bytes(b"PAR1")
    report = EvaluationReport(kept, blind=True)
    told = report.to_dict()
    rates = {one["guidance"]: one["elegant"] for one in told["methods"]}
    assert (rates["none"]["rate"], rates["jiti"]["rate"]) == (0.3, 0.75)
    assert rates["none"]["interval"] == pytest.approx((0.1455, 0.5190), abs=1e-3)
    (pair,) = told["pairings"]
    assert (pair["only_first"], pair["only_second"]) in {(0, 9), (9, 0)}
    assert pair["p"] == pytest.approx(2 / 2**9)
    report.print()
    printed = capsys.readouterr().out
    assert "so100/T4 (so100-T4)" in printed
    assert "so100/T5 (again)" in printed
    assert "0.30 (0.15 to 0.52)" in printed, "its own, and not those of the folder beside it"
    assert "0.75 (0.53 to 0.89)" in printed


def test_what_does_not_fit_is_refused_and_nothing_changes(tmp_path):
    play(evaluation(tmp_path, Person("\nyy" * 4)))
    before = (tmp_path / FILE).read_bytes()
    with pytest.raises(UsageError, match=r"with seconds 30.0 and not 5.0"):
        open_kept(tmp_path, {**SETTINGS, "seconds": 5.0}, 4)
    assert (tmp_path / FILE).read_bytes() == before
    (tmp_path / FILE).write_bytes(before[:-9])
    with pytest.raises(SourceError, match=r"evaluation.parquet is damaged.*Move it away"):
        open_kept(tmp_path, SETTINGS, 4)


def test_another_policy_in_its_place_is_known_and_one_that_is_nowhere_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, weights in (("one", b"1"), ("two", b"2")):
        folder = tmp_path / name / "checkpoints" / "last" / "pretrained_model"
        folder.mkdir(parents=True)
        (folder / "config.json").write_text("{}")
        (folder / "model.safetensors").write_bytes(weights)

    def shared(policy: str) -> dict:
        request = RobotRequest(RobotSettings(port="virtual"), policy=policy)
        return shared_of(request, TASK, (GUIDANCES["none"],))

    assert shared("one") == shared("one/checkpoints/last/pretrained_model")
    assert shared("one")["policy"] != shared("two")["policy"]
    assert shared("hub/one")["policy"] == "hub/one"
    with pytest.raises(UsageError, match="there is no policy 'three' here"):
        shared("three")
    tmp_path.joinpath("a").mkdir()
    open_kept(tmp_path / "a", {**SETTINGS, "guidance jiti": {"tau": 0.5, "window": 2}}, 4).save()
    with pytest.raises(UsageError, match=r"with guidance jiti tau 0.5 and not 0.3;"):
        open_kept(tmp_path / "a", {**SETTINGS, "guidance jiti": {"tau": 0.3, "window": 2}}, 4)


def _segments(folder: Path) -> list[dict]:
    from jiti.episodes.reader import open_reader

    return read_segments(Path(open_reader(folder / "judged").labels_dir)).to_pylist()

import pytest

from jiti.curate.export.filter import NAMES, Filter
from jiti.curate.export.filter_names import Known, values_told
from jiti.errors import UsageError

EPISODE = {
    "episode": "pick_3", "source": "demos", "task": "elegant/T2", "instruction": "put the bowl on the plate",
    "frames": 240, "seconds": 12.0, "segments": 1, "annotators": "ann,ben", "annotated": 0.1, "reward": 1,
    "return": 0.25, "peak_return": 19.8, "success": None, "split": "train", "itc": {"elegant/T2/centered": 1},
}  # fmt: skip


def test_the_names_that_are_told_are_those_of_an_episode():
    assert NAMES.keys() == EPISODE.keys()


@pytest.mark.parametrize(
    ("text", "kept"),
    [
        ("reward == 1", True),
        ("reward == 0", False),
        ("reward == 1 and frames < 200", False),
        ("reward == 0 or not frames < 200", True),
        ("100 < frames <= 240", True),
        ("return > 0.2 and peak_return < 20", True),
        ("instruction == 'return'", False),
        ("task in ('elegant/T1', 'elegant/T2')", True),
        ("'ann' in annotators", True),
        ("episode not in ['pick_1', 'pick_3']", False),
        ("itc['elegant/T2/centered'] == 1", True),
        ("itc['centered'] == 1", True),
        ("itc['elegant/T0/release-inside'] == 1", False),
        ("itc['elegant/T0/release-inside'] == None", True),
        ("success", False),
        ("success == None", True),
        ("success is None", True),
        ("success > 0", False),
        ("frames > -5", True),
    ],
)
def test_a_condition_holds_or_not(text, kept):
    assert Filter(text)(EPISODE) is kept


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("rewards == 1", "did you mean 'reward'"),
        ("banana == 1", "there are: episode, source, task"),
        ("reward = 1", "--filter 'reward = 1'"),
        ("reward ==", "Write a condition like"),
        ("", "Write a condition like"),
        ("__import__('os').system('true')", "only comparisons"),
        ("(lambda: 1)()", "only comparisons"),
        ("[x for x in annotators]", "only comparisons"),
        ("frames.real == 1", "only comparisons"),
        ("frames + 1 == 2", "only comparisons"),
        ("itc == 1", "itc takes an id"),
        ("task[0] == 'e'", "only comparisons"),
        ("(" * 3000 + "1" + ")" * 3000, "--filter"),
    ],
)
def test_what_is_no_condition_is_refused_and_never_run(text, said):
    with pytest.raises(UsageError, match=r"(?s).*") as refused:
        Filter(text)
    assert said in str(refused.value)


KNOWN = Known(
    ("elegant/T2", "elegant/T7"),
    ("elegant/T2", "elegant/T7", "so100/T2", "so100/T3", "mine/T3"),
    ("elegant/T2/centered", "elegant/T7/upright"),
    ("elegant/T2/centered", "elegant/T7/upright", "so100/T2/slow"),
)


@pytest.mark.parametrize(
    "text", ["task == 'T2'", "'elegant/T2' == task", "task in ('T7', 'T2')", "reward == 1 and not task != 'T2'"]
)
def test_the_end_of_a_tasks_id_is_enough(text):
    assert Filter(text).completed(KNOWN)(EPISODE) is True
    assert Filter(text).completed(KNOWN)(EPISODE | {"task": "so100/T2"}) is False


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("reward == 1 and itc['centred'] == 1", "column 17: there is no ITC 'centred'; did you mean 'centered'? There"),
        ("itc['elegant/T2/upright'] == 1", "did you mean 'elegant/T7/upright'"),
        ("task == 'T9'", "column 9: there is no task 'T9'; there are: elegant/T2, elegant/T7."),
        ("task in ['T2', 'T3']", "'T3' is the end of several tasks' ids: so100/T3, mine/T3"),
    ],
)
def test_unknown_tasks_and_itcs_are_refused_before_any_episode(text, said):
    with pytest.raises(UsageError) as refused:
        Filter(text).completed(KNOWN)
    assert said in str(refused.value)


@pytest.mark.parametrize("text", ["'T9' in task", "instruction == 'T9'", "itc['slow'] == None", "task == None"])
def test_other_texts_are_left_alone(text):
    Filter(text).completed(KNOWN)


def test_the_values_of_what_was_asked_for_are_told():
    condition = Filter("success or return > 30 and frames < 10 and itc['centered'] == 0 and frames > 2")
    assert condition.names == ["success", "return", "frames", "itc['centered']"]
    episodes = [EPISODE | {"frames": n, "success": True if n > 150 else None} for n in (150, 240, 420)]
    told = "success None (1), True (2); return 0.25 (3); frames 150 to 420; itc['centered'] 1 (3)"
    assert values_told(condition.names, episodes) == told


def test_what_cannot_be_compared_is_said():
    with pytest.raises(UsageError, match="str and int cannot be compared"):
        Filter("task < 3")(EPISODE)
    with pytest.raises(UsageError, match="int and int cannot be compared"):
        Filter("1 in frames")(EPISODE)

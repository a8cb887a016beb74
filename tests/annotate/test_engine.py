"""The same function over many items: each comes once, few at a time, in threads and on a Ray that loses workers."""

import importlib.util
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import psutil
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jiti.annotate.engine import RAY_RETRIES, WAITING, WorkerLost, cores, run
from jiti.errors import UsageError

SOON_S = 20.0
"""What should happen at once has happened by then, on a busy machine too."""


def on_ray(test):
    """Marks a test that starts a real Ray."""
    why = "Ray is not installed: pip install 'jiti[ray]'"
    return pytest.mark.slow(pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason=why)(test))


@dataclass(frozen=True)
class Power:
    """Called with a number, as the proposer is with an episode's id: an object, and not a function."""

    exponent: int

    def __call__(self, number: int) -> int:
        return number**self.exponent


@dataclass(frozen=True)
class Dying:
    """Squares a number, and says on which machine; some numbers kill the process that they are given to."""

    folder: Path
    """Where each death leaves a line."""
    once: int | None = None
    always: int | None = None
    takes_s: float = 0.1

    def __call__(self, number: int) -> tuple[int, str]:
        import ray

        deaths = self.folder / str(number)
        if number == self.always or (number == self.once and not deaths.exists()):
            with deaths.open("a") as file:
                file.write("died\n")
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(self.takes_s)
        return number * number, ray.get_runtime_context().get_node_id()


@dataclass(frozen=True)
class Waiting:
    """Leaves a file for each number that was begun, and waits for one named `go`, but with 0."""

    folder: Path

    def __call__(self, number: int) -> int:
        (self.folder / f"begun-{number}").touch()
        while number and not (self.folder / "go").exists():
            time.sleep(0.02)
        return number


def wait_for(what, seconds: float = SOON_S) -> None:
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.02)


# In threads


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(0, 3), max_size=24), st.integers(1, 5))
def test_every_item_comes_once_with_its_own_result_however_long_each_takes(milliseconds, workers):
    # Lists, which cannot be keys of a dictionary, and of which some are equal.
    items = [[k // 2, delay] for k, delay in enumerate(milliseconds)]

    def work(item: list[int]) -> int:
        time.sleep(item[1] / 1000)
        return 1000 * item[0] + item[1]

    found = list(run(work, items, workers=workers))
    assert sorted(item for item, _ in found) == sorted(items)
    assert all(result == 1000 * item[0] + item[1] for item, result in found)


def test_results_come_as_they_are_ready():
    first = threading.Event()

    def work(number: int) -> int:
        if number == 0:
            assert first.wait(SOON_S)
        return number

    with closing(run(work, range(3), workers=2)) as results:
        assert {next(results), next(results)} == {(1, 1), (2, 2)}
        first.set()
        assert list(results) == [(0, 0)]


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_few_items_are_under_way_and_as_many_at_once_as_there_are_workers(workers):
    mutex, meeting = threading.Lock(), threading.Barrier(workers)
    under_way = running = most_under_way = most_running = 0

    def items() -> Iterator[int]:
        nonlocal under_way, most_under_way
        for number in range(12 * workers):
            with mutex:
                under_way += 1
                most_under_way = max(most_under_way, under_way)
            yield number

    def work(number: int) -> int:
        nonlocal under_way, running, most_running
        with mutex:
            running += 1
            most_running = max(most_running, running)
        meeting.wait(SOON_S)  # passes when so many run at once, and fails when they never do
        wait_for(lambda: number >= workers or most_under_way == WAITING * workers)
        with mutex:
            running -= 1
            under_way -= 1
        return number

    found = sorted(run(work, items(), workers=workers))
    assert found == [(number, number) for number in range(12 * workers)]
    assert most_under_way == WAITING * workers
    assert most_running == workers


def test_whoever_takes_results_slowly_does_not_pile_them_up():
    taken, done = count(), threading.Semaphore(0)
    numbers: list[int] = []

    def items() -> Iterator[int]:
        for number in taken:
            numbers.append(number)
            yield number

    def work(number: int) -> int:
        done.release()
        return number

    with closing(run(work, items(), workers=2)) as results:
        for received in range(1, 6):
            next(results)
            # Everything that was handed out gets done, and nothing more is taken from the source meanwhile.
            for _ in range(WAITING * 2 + 1 if received == 1 else 1):
                assert done.acquire(timeout=SOON_S)
            assert len(numbers) == WAITING * 2 + received


def test_an_endless_source_can_be_left():
    with closing(run(Power(2), count(), workers=2)) as results:
        found = [next(results) for _ in range(10)]
    assert len(dict(found)) == 10
    assert all(square == number * number for number, square in found)
    assert next(results, None) is None


def test_closing_early_stops_what_has_not_begun(tmp_path):
    results = run(Waiting(tmp_path), range(100), workers=2)
    assert next(results) == (0, 0)
    wait_for(lambda: len(list(tmp_path.iterdir())) == 3)  # both workers have one that waits
    threading.Timer(0.5, (tmp_path / "go").touch).start()
    results.close()  # waits for what has begun
    assert (tmp_path / "go").exists()
    assert sorted(path.name for path in tmp_path.glob("begun-*")) == ["begun-0", "begun-1", "begun-2"]


def test_a_bug_in_the_work_keeps_its_traceback_and_ends_it():
    begun: list[int] = []

    def work(number: int) -> float:
        begun.append(number)
        return 1 / (number - 1)

    with pytest.raises(ZeroDivisionError) as caught:
        list(run(work, range(1000), workers=1))
    assert any(entry.name == "work" for entry in caught.traceback)
    assert len(begun) <= 2 + WAITING


def test_a_source_that_fails_fails_for_who_asked():
    def items() -> Iterator[int]:
        yield from range(3)
        raise OSError("the disk is gone")

    with pytest.raises(OSError, match="the disk is gone"):
        list(run(Power(2), items(), workers=1))


def test_nothing_to_do_is_done():
    assert list(run(Power(2), [])) == []


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="only Linux lets a process choose its cores")
def test_there_are_as_many_workers_as_cores_that_may_be_used():
    allowed = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {min(allowed)})
        assert cores() == 1
        threads = {thread for _, thread in run(lambda _: threading.get_ident(), range(20))}
    finally:
        os.sched_setaffinity(0, allowed)
    assert len(threads) == 1
    assert cores() == len(allowed)


def test_without_ray_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)  # Python's own way to say that there is none
    with pytest.raises(UsageError, match=r"pip install 'jiti\[ray\]'"):
        list(run(Power(2), range(3), engine="ray"))


# On Ray


def descendants(of: int | None = None) -> set[psutil.Process]:
    try:
        return set(psutil.Process(of).children(recursive=True))
    except psutil.NoSuchProcess:
        return set()


def all_gone(processes: Iterable[psutil.Process]) -> bool:
    """Waits for them; what stays is ended, so that it is left to no other test."""
    _, alive = psutil.wait_procs(processes, timeout=60)
    for process in alive:
        process.kill()
    return not alive


@pytest.fixture(scope="module")
def ray_home() -> Iterator[Path]:
    """Ray's files in a folder of their own, so that a Ray that runs here already is neither found nor touched."""
    folder = Path(tempfile.mkdtemp(prefix="jiti-", dir="/tmp"))  # with pytest's own, names of sockets get too long
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_TMPDIR", str(folder))
        patch.delenv("RAY_ADDRESS", raising=False)
        yield folder
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(scope="module")
def cluster(ray_home):
    """Two machines of one core each, in processes of this one, and this process their driver."""
    import ray
    from ray.cluster_utils import Cluster

    before = descendants()
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    cluster.add_node(num_cpus=1)
    ray.init(address=cluster.address, log_to_driver=False, logging_level="ERROR")
    yield cluster
    own = descendants() - before
    ray.shutdown()
    cluster.shutdown()
    assert own
    assert all_gone(own)


def squares(found: Iterable[tuple[int, object]]) -> list[tuple[int, object]]:
    """Numbers and squares in order, without the machines that they are from."""
    return sorted((number, result[0]) for number, result in found if isinstance(result, tuple))


@on_ray
@pytest.mark.parametrize("early", [False, True])
def test_a_ray_of_its_own_replaces_a_worker_that_died_and_leaves_no_process(ray_home, tmp_path, early):
    import ray

    assert not ray.is_initialized()
    before, seen = descendants(), set()
    found = []
    with closing(run(Dying(tmp_path, once=3), range(8), engine="ray", workers=2)) as results:
        for one in results:
            found.append(one)
            seen |= descendants() - before
            if early and len(found) == 2:
                break
    assert len(found) == (2 if early else 8)
    assert set(squares(found)) <= {(k, k * k) for k in range(8)}
    assert len(dict(found)) == len(found)
    assert early or (tmp_path / "3").read_text() == "died\n"
    assert not ray.is_initialized()
    assert len(seen) > 2  # the cluster's own processes and the workers
    assert all_gone(seen)


@on_ray
def test_an_address_that_is_none_is_said(ray_home):
    import ray

    with pytest.raises(UsageError, match=r"no Ray cluster at somewhere: .*leave --ray-address out"):
        list(run(Power(2), range(3), engine="ray", address="somewhere"))
    assert not ray.is_initialized()


@on_ray
def test_an_address_at_which_no_one_answers_is_said_soon(ray_home):
    code = (
        "from jiti.annotate.engine import run\n"
        "from jiti.errors import UsageError\n"
        "try:\n"
        "    list(run(abs, range(3), engine='ray', address='127.0.0.1:1'))\n"
        "except UsageError as error:\n"
        "    print(error)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        try:
            said, _ = process.communicate(timeout=60)
        finally:
            process.kill()
    assert said.startswith("no Ray cluster")
    assert "127.0.0.1:1" in said
    assert "ray start --head" in said


@on_ray
@pytest.mark.parametrize("how", [{"address": "auto"}, {"workers": 2}], ids=str)
def test_a_cluster_that_was_started_on_this_machine_is_used_or_left_alone(ray_home, how):
    """As `ray start --head` starts it, which the message of a missing cluster says."""
    ray = str(Path(sys.executable).with_name("ray"))
    command = [ray, "start", "--head", "--block", "--num-cpus", "2", "--port", "0", "--include-dashboard", "false"]
    named = ray_home / "ray" / "ray_current_cluster"
    named.unlink(missing_ok=True)
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        own: set[psutil.Process] = set()
        try:
            wait_for(named.exists, 100)
            own = descendants(process.pid)
            assert sorted(run(Power(2), range(3), engine="ray", **how)) == [(0, 0), (1, 1), (2, 4)]
            assert process.poll() is None
        finally:
            own |= descendants(process.pid)
            process.terminate()
            process.communicate(timeout=60)
            gone = all_gone(own)
    assert gone


@on_ray
def test_two_machines_do_each_item_once_though_a_worker_dies(cluster, tmp_path):
    import ray

    found = list(run(Dying(tmp_path, once=4), range(12), engine="ray"))
    assert squares(found) == [(k, k * k) for k in range(12)]
    assert (tmp_path / "4").read_text() == "died\n"
    nodes = {node["NodeID"] for node in ray.nodes() if node["Alive"]}
    assert {result[1] for _, result in found if isinstance(result, tuple)} == nodes
    assert len(nodes) == 2
    assert ray.is_initialized()  # it was there before


@on_ray
def test_an_item_that_kills_every_worker_is_given_up_and_the_others_come(cluster, tmp_path):
    found = list(run(Dying(tmp_path, always=3), range(8), engine="ray"))
    assert Counter(number for number, _ in found) == dict.fromkeys(range(8), 1)
    assert squares(found) == [(k, k * k) for k in range(8) if k != 3]
    lost = dict(found)[3]
    assert isinstance(lost, WorkerLost)
    assert f"{RAY_RETRIES + 1} times" in str(lost)
    assert (tmp_path / "3").read_text() == "died\n" * (RAY_RETRIES + 1)


@on_ray
def test_a_machine_that_is_lost_takes_no_item_with_it(cluster, tmp_path):
    import ray

    before = {node["NodeID"] for node in ray.nodes()}
    machine = cluster.add_node(num_cpus=1)
    found, removed = [], False
    with closing(run(Dying(tmp_path, takes_s=0.5), range(14), engine="ray", workers=3)) as results:
        for number, result in results:
            found.append((number, result))
            if not removed and isinstance(result, tuple) and result[1] not in before:
                cluster.remove_node(machine, allow_graceful=False)  # which has begun another one by now
                removed = True
    assert removed
    assert squares(found) == [(k, k * k) for k in range(14)]


@on_ray
def test_few_items_are_under_way_on_ray(cluster):
    received = taken = most = 0

    def items() -> Iterator[int]:
        nonlocal taken, most
        for number in range(30):
            taken += 1
            most = max(most, taken - received)
            yield number

    found = []
    for one in run(Power(3), items(), engine="ray", workers=2):
        received += 1
        found.append(one)
    assert sorted(found) == [(k, k**3) for k in range(30)]
    assert most == WAITING * 2 + 1  # those under way, and the one that is being handed over


@on_ray
def test_a_bug_in_the_work_on_ray_is_told(cluster):
    with pytest.raises(ZeroDivisionError):
        list(run(Power(-1), [2, 0, 1], engine="ray"))


@on_ray
def test_closing_early_stops_what_has_not_begun_on_a_ray_that_stays(cluster, tmp_path):
    results = run(Waiting(tmp_path), range(100), engine="ray", workers=2)
    assert next(results) == (0, 0)
    wait_for(lambda: len(list(tmp_path.glob("begun-*"))) == 3)
    results.close()
    (tmp_path / "go").touch()
    assert dict(run(Power(2), range(10, 14), engine="ray")) == {k: k * k for k in range(10, 14)}  # Ray goes on
    assert sorted(path.name for path in tmp_path.glob("begun-*")) == ["begun-0", "begun-1", "begun-2"]

"""The subprocess by itself: its lines, its end, and how it is ended."""

import os
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest
from dante_w_addon.contract.protocol import Step
from dante_w_addon.contract.vocabulary import STAGES
from running import alive

from dante_w_addon.bridge import process
from dante_w_addon.bridge.process import GRACE, Lines, Process, read_now
from dante_w_addon.bridge.progress import Progress


def python(code):
    return Process([sys.executable, "-I", "-u", "-c", code])


def wait(started, seconds=20.0):
    """Ask for the exit status until there is one."""
    end = time.monotonic() + seconds
    while started.returncode is None:
        assert time.monotonic() < end
        time.sleep(0.01)
    return started.returncode


def test_messages_and_log_are_told_apart():
    lines = '{"stage": "bake", "step": 1, "total": 2}', "no message", '{"no": "stage"}', "[1]"
    started = python(
        f"import sys; [print(line) for line in {lines!r}]; print('log', file=sys.stderr); sys.exit(7)"
    )
    assert wait(started) == 7
    assert started.messages() == [Step("bake", 1.0, 2.0)] and started.messages() == []
    assert sorted(started.last_lines()) == sorted([*lines[1:], "log"])


def test_lines_in_pieces_and_a_last_one_without_end():
    code = (
        "import sys, time; w = sys.stdout.buffer.write; w(b'on'); time.sleep(.2); w('é\\nend\\xff'.encode())"
    )
    started = python(code + "; w(b'\\xff')")
    wait(started)
    assert started.last_lines() == ["oné", "endÿ\N{REPLACEMENT CHARACTER}"]


def test_nobody_waits_for_a_silent_process():
    started = python("import time; time.sleep(60)")
    before = time.monotonic()
    assert started.returncode is None and started.messages() == [] and started.last_lines() == []
    assert time.monotonic() - before < 1.0
    started.close()
    assert time.monotonic() - before < GRACE + 2.0 and not alive(started.pid)
    assert started.cancelled and started.returncode is not None


def test_more_than_a_pipe_holds_arrives_whole():
    started = python("for i in range(20000): print('x' * 40, i)")
    count, lines = 0, []
    while started.returncode is None:
        lines += started.last_lines(1)
        count += 1
    assert started.last_lines(1) == ["x" * 40 + " 19999"] and count


def test_a_process_that_never_stops_writing_holds_nobody_up():
    started = python("while True: print('y' * 1000)")
    time.sleep(0.3)
    for _ in range(5):
        before = time.monotonic()
        assert started.returncode is None
        assert time.monotonic() - before < 1.0
    started.close()
    assert started.returncode is not None


def test_a_child_that_holds_the_pipe_is_not_waited_for():
    code = (
        "import subprocess, sys; p = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(30)'])"
    )
    started = python(code + "; print(p.pid); print('end', end='')")
    before = time.monotonic()
    assert wait(started) == 0 and time.monotonic() - before < 20.0
    number, end = started.last_lines()
    os.kill(int(number), 9)
    assert end == "end"


def test_what_does_not_end_politely_is_killed():
    started = python("import signal, time; signal.signal(15, signal.SIG_IGN); print('on'); time.sleep(60)")
    while not started.last_lines():
        started.messages()
    before = time.monotonic()
    started.cancel()
    assert time.monotonic() - before < 0.3, "cancel does not wait"
    assert started.returncode is None
    assert wait(started) == -9 and GRACE <= time.monotonic() - before < GRACE + 2.0


def test_one_that_has_ended_is_not_cancelled():
    started = python("pass")
    assert wait(started) == 0
    started.cancel()
    assert not started.cancelled and started.returncode == 0


def test_kill_is_at_once():
    started = python("import signal, time; signal.signal(15, signal.SIG_IGN); time.sleep(60)")
    started.kill()
    assert not alive(started.pid) and started.returncode == -9


@pytest.mark.skipif(sys.platform == "win32", reason="a stand-in for Windows' calls")
def test_pipes_are_read_as_on_windows(monkeypatch):
    """There the pipe is asked how much it holds, and is never non-blocking."""
    import array
    import fcntl
    import termios

    def peek(handle, size):
        waiting = array.array("i", [0])
        fcntl.ioctl(handle, termios.FIONREAD, waiting)
        if not waiting[0] and closed:
            raise BrokenPipeError
        return waiting[0], 0

    closed = []
    monkeypatch.setattr(process, "sys", SimpleNamespace(platform="win32"))
    monkeypatch.setattr(process, "_winapi", SimpleNamespace(PeekNamedPipe=peek), raising=False)
    monkeypatch.setattr(process, "msvcrt", SimpleNamespace(get_osfhandle=lambda fd: fd), raising=False)
    reading, writing = os.pipe()
    lines = Lines(os.fdopen(reading, "rb", 0))
    assert os.get_blocking(reading) and read_now(reading) is None and lines.read() == []
    os.write(writing, b"one\ntw")
    assert lines.read() == ["one"]
    os.write(writing, b"o")
    os.close(writing)
    closed.append(True)
    assert lines.read() == ["two"] and lines.read() == []


def test_stages_are_counted_whichever_model_runs():
    for stages in STAGES.values():
        number, count = Progress(step=Step(stages[-4], 0.0, 0.0)).stage_number
        assert (number, count) == (len(stages) - 3, len(stages)) and stages[number - 1] == stages[-4]
    assert Progress(step=Step("resting", 0.0, 0.0)).stage_number == (0, 0)


def test_the_environment_is_clean(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", "/nowhere")
    names = subprocess.run(
        [sys.executable, "-c", "import os; print(*os.environ)"],
        env=process.clean_environment(),
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    assert "PATH" in names and not [name for name in names if name.startswith("PYTHON")]

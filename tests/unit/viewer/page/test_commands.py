import threading

from so101_viewer.server.host import Commands


def test_commands_run_in_order_and_once_and_one_that_fails_is_reported():
    done, errors = [], []
    commands = Commands(errors.append)
    commands.post(lambda: done.append("dropped"))
    commands.drop()
    assert not commands.run()
    commands.post(lambda: done.append(0))
    commands.post(lambda: 1 / 0)
    commands.post(lambda: done.append(1))
    assert commands.run()
    assert not commands.run()
    assert done == [0, 1]
    assert isinstance(errors[0], ZeroDivisionError)


def test_a_drop_waits_for_the_command_under_way_and_forgets_the_rest():
    """Otherwise a move that is just being started could slip behind the stop."""
    done = []
    started, may_end = threading.Event(), threading.Event()
    commands = Commands(lambda _error: None)

    def start_a_move():
        started.set()
        assert may_end.wait(60.0)
        done.append("start")

    def stop():
        commands.drop()
        done.append("stop")

    commands.post(start_a_move)
    commands.post(lambda: done.append("never"))
    page = threading.Thread(target=commands.run)
    page.start()
    assert started.wait(60.0)
    stopping = threading.Thread(target=stop)
    stopping.start()
    may_end.set()
    page.join(60.0)
    stopping.join(60.0)
    assert done == ["start", "stop"]


def test_who_waits_for_a_command_goes_on_when_one_was_posted():
    commands = Commands(lambda _error: None)
    commands.post(lambda: None)
    commands.wait(timeout=1000.0)
    commands.wait(timeout=0.0)
    assert commands.run(), "waiting takes no command away"

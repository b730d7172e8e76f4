"""Who has the ghost: a program's rehearsal, or the target that is to be recorded."""

from so101_viewer.page.page_context import PROGRAM, Drawn, FrontTab


def test_the_ghost_belongs_to_what_was_asked_for_last():
    tab, rehearsal, first, second = FrontTab(PROGRAM), object(), object(), object()
    looks = (  # time of the rehearsal, target: who has the ghost
        (0.0, first, Drawn.NOTHING),
        (0.1, first, Drawn.NOTHING),
        (0.1, second, Drawn.TARGET),
        (0.1, second, Drawn.TARGET),
        (0.2, second, Drawn.NOTHING),
        (0.3, first, Drawn.TARGET),  # it stopped and a waypoint was clicked, between two looks
        (0.3, first, Drawn.TARGET),
        (0.4, second, Drawn.TARGET),
        (0.5, second, Drawn.NOTHING),  # it plays on
    )
    for t, target, drawn in looks:
        tab.note(rehearsal, t, (target,), runs=False)
        assert tab.drawn is drawn

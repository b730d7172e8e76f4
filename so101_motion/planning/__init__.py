"""From a request to a verified trajectory: numbers in, numbers out.

``planner.py`` runs the stages; each stage has a folder: ``kinematics``, ``collision``, ``paths``,
``timing``, ``cartesian`` (lines and arcs of the tool) and ``differential`` (jogging and dragging).
Nothing here knows a port, a thread, a clock or Viam. It may import ``common`` only.

What means the same everywhere is said here: ``q``, ``qd``, ``qdd`` are the joints' angles,
velocities and accelerations, shape (5,), [rad], [rad/s], [rad/s^2]; ``q_jaw`` is the jaw's angle
[rad]; ``lower`` and ``upper`` are joint limits, shape (5,), [rad]; ``dt`` is the time between
samples [s]; ``collision`` holds what is in the way; ``checkpoint`` is called every few milliseconds
and raises to give up.
"""

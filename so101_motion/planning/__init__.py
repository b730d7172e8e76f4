"""Plan a verified trajectory for a request: numbers in, numbers out.

``planner.py`` runs the stages; each stage has a folder: ``kinematics``, ``collision``, ``paths``,
``timing``, ``cartesian`` (lines and arcs of the tool), ``differential`` (jogging and following) and
``cell`` (several arms together); ``native`` holds the C sources. Nothing here knows a port, a
thread, a clock or Viam. It may import ``common`` only.

Names that mean the same everywhere: ``q``, ``qd``, ``qdd`` are the joints' angles, velocities and
accelerations, shape (5,), [rad], [rad/s], [rad/s^2]; ``q_start``, ``q_goal``, ``q_from``, ``q_to``
and ``q_seed`` are joint angles too; ``q_jaw`` is the jaw's angle [rad]; ``lower`` and ``upper`` are
joint limits, shape (5,), [rad]; ``p_base`` is a point in the base frame, shape (3,), [m];
``R_base_tool`` a rotation, shape (3, 3); ``pan``, ``pitch`` and ``roll`` are angles [rad]; ``dt``
is the time between samples [s]; ``collision`` checks for contact; ``checkpoint`` is called every
few milliseconds and raises to give up.
"""

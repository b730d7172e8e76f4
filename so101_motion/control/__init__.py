"""The control loop: one thread per serial port that plays setpoints at 100 Hz.

``executor.py`` has the thread, ``joint_controller.py`` what one cycle does, ``channel_player.py``
how arm and jaw each play a ``motion_source.py``. It may import ``planning``, ``drivers`` and
``common``.
"""

"""The referee: it watches every emulated bus of the tests and knows the rules of motion.

It shares no code with the driver. What was said on the wire it parses itself (``packets.py``), how
the joints truly move it sees in the emulated world, and where the arm is commanded it learns from
the record of ``q_cmd`` (``command.py``). ``wire.py`` judges goals and torque, ``joint_motion.py``
the joints, ``command.py`` the command. A finding fails the test in which it occurs, unless the test
says which rule it breaks on purpose: ``@pytest.mark.breaks("motion", reason="...")``.

All angles in here are degrees, as in the rules.
"""

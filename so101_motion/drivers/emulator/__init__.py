"""The emulator: six virtual STS3215 servos behind a pseudo-terminal.

From the wire inwards:

    pty_port   the pseudo-terminal and its thread; delays replies
    bus        which servos hear an instruction, and when they answer
    codec      packets
    servo      carries out instructions on ``memory`` and ``registers``
    drive      controller and protections: ``motion``, ``protection``, ``electric``
    mechanics  motor, play, friction, stops; ``joint_figures`` has their numbers
    world      the six servos with gravity, supply and time; ``hand`` is a person's hand
    faults     faults to inject; ``emulator`` builds the whole, ``run`` is the program

Everything below ``pty_port`` is free of clocks, threads and ports: time comes in as a number.
"""

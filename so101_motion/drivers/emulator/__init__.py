"""The emulator: six virtual STS3215 servos behind a pseudo-terminal.

From the wire inwards:

    pty_port   a pseudo-terminal and its thread: when bytes arrive
    bus        who hears an instruction and when the answer leaves
    codec      packets
    servo      what an instruction does to ``memory``, ``registers`` and ``register_values``
    drive      controller and protections: ``motion``, ``protection``, ``electric``
    mechanics  motor, play, friction, stops; ``hardware`` holds the figures
    world      six of them, gravity, supply, time; ``hand`` is a person's
    faults     what goes wrong; ``emulator`` puts it all together, ``run`` is the program

Everything below ``pty_port`` is free of clocks, threads and ports: time comes in as a number.
"""

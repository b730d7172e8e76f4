"""Requests to components on servos that cannot be meant or done: which, and what is said."""

import math

from grpclib import Status
from harness.emulated_rig import arm_client, gripper_client
from harness.in_process_module import refused

ARM = [
    ({"command": "diagnoze"}, 'did you mean "diagnose"'),
    ({"set_torque": True}, '"set_torque" is a command, not a key: send {"command": "set_torq'),
    ({"set_torqe": True}, 'did you mean "set_torque"?'),
    ({"command": "set_torque"}, "enable"),
    ({"command": "set_torque", "enable": "yes"}, "true or false"),
    ({"command": "enter_manual_mode", "torque_limit": 1001.0}, "torque_limit"),
    ({"command": "reinitialize", "retries": 0}, "retries"),
    ({"command": "set_torque_limit", "value": 1001}, "value"),
    ({"command": "identify", "joints": ["gripper"]}, "must be some of shoulder_pan"),
    ({"command": "identify", "joints": ["wrist_flex"], "carrying": True}, "must be all"),
    ({"get_motion_params": 1.0}, "true or false"),
    ({"command": "servo_move", "servo_id": 3, "percent": 10}, "moves the arm, not the jaw"),
    ({"command": "servo_move", "servo_id": 7, "percent": 10}, "6"),
    ({"command": "servo_move", "percent": 10}, "servo_id"),
    ({"command": "servo_move", "servo_id": 6}, "percent"),
    ({"command": "servo_move", "servo_id": 6, "raw": 5000}, "4095"),
    ({"command": "servo_move", "servo_id": 6, "percent": 10, "speed": 0}, "speed"),
]
GRIPPER = [
    ({"command": "set_position"}, "servo_position"),
    ({"command": "set_position", "percentage": math.nan}, "finite"),
    ({"command": "set_position", "servo_position": "wide"}, "number"),
    ({"command": "calibrate_positions", "open_position": 101}, "0 to 100"),
    ({"command": "calibrate_positions", "closed_position": 99}, "below open_position"),
    ({"command": "set_motion_params", "speed": 181}, "180"),
    ({"command": "grab"}, "known"),
    ({"set": 20.0, "wait": "no"}, "true or false"),
]
SENSOR = [
    ({"command": "start_recording"}, 'did you mean "start_range_recording"'),
    ({"command": "motor_setup_asign_id"}, 'did you mean "motor_setup_assign_id"'),
    ({"command": "motor_setup_skip", "retries": 3}, "unknown argument"),
    ({"command": "motor_setup_discover"}, 'name the motor, such as "gripper"'),
    ({"command": "motor_setup_discover", "motor_name": "elbow"}, 'did you mean "elbow_flex"'),
    ({"command": "setup_steps", "workflow": "ful"}, 'did you mean "full"'),
    ({"command": "stop_range_recording", "accept": "elbow_flex"}, "list of names"),
    ({"comand": "start"}, "known"),
    ({}, "known"),
]


async def test_a_request_that_cannot_be_done_is_refused_with_the_reason(models):
    async with arm_client(models.new_arm()) as arm, gripper_client(models.new_gripper()) as gripper:
        sensor = models.new_sensor()
        for component, table in ((arm, ARM), (gripper, GRIPPER), (sensor, SENSOR)):
            for request, says in table:
                await refused(component.do_command(request), Status.INVALID_ARGUMENT, says)

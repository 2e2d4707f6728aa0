#!/usr/bin/env python3
"""A console and a robot of ITP, the interoperability telesurgery protocol, for tests of the one in actors/network.

Only Python's own library; written from the protocol's structs, not from the other program, so that the two check each other.

    itp_peer.py selftest                          sizes, offsets, round trips, checksums; exit code 1 says what is wrong
    itp_peer.py emit                              fixed packets as JSON lines: {"name", "bytes", "hex"}
    itp_peer.py console                           hands as JSON lines in, packets as JSON lines out
        {"hands": [{"position": [m, m, m], "rotation": [x, y, z, w]}, {...}], "pedal": true}  ->  {"hex"}
    itp_peer.py robot                             packets in hexadecimal digits in, a line each; JSON lines out
        {"verdict", "position_um", "rotation", "jaw_mrad", "buttons", "runlevel", "reply"}
    itp_peer.py console --udp PORT [--packets N] [--hz HZ]    sends a motion to 127.0.0.1:PORT, prints the replies
                [--press BITS FROM TO]                        with these buttons of both hands in packets FROM to TO
    itp_peer.py robot --udp PORT [--packets N]                hears on 127.0.0.1:PORT (0: any, printed first), replies to the
                                                              sender, prints what became of each packet
                [--stop FROM TO]                              in an emergency stop from its packet FROM to TO
"""
import argparse
import json
import math
import socket
import struct
import sys
import time

CONSOLE = struct.Struct("<3I 2i 2i 2i 2d 2d 2d 2d 2i 2i i i")
MATRIX_CONSOLE = struct.Struct("<3I 2i 2i 2i 9d 9d 2i 2i i i")
ROBOT = struct.Struct("<4I 2i 2i 2i i I i")
IDENTITY = (0.0, 0.0, 0.0, 1.0)
JAW_MRAD = (int(-10.0 * 1000.0 * math.pi / 180.0), int(math.pi / 2.0 * 1000.0))


def int32(number):
    """The number as the 32 bits of C's int hold it."""
    number &= 0xFFFFFFFF
    return number - (1 << 32) if number >> 31 else number


def console_packet(sequence, kind, version, delx, dely, delz, rotations, buttons, grasp, surgeon_mode, checksum=None):
    """Rotations: two quaternions x, y, z, w, or two matrices of nine numbers each."""
    if checksum is None:
        checksum = int32(surgeon_mode + sum(delx) + sum(dely) + sum(delz) + sum(buttons) + sequence)
    head = (sequence, kind, version, *delx, *dely, *delz)
    tail = (*buttons, *grasp, surgeon_mode, checksum)
    left, right = rotations
    if len(left) == 9:
        return MATRIX_CONSOLE.pack(*head, *left, *right, *tail)
    return CONSOLE.pack(*head, *(component for pair in zip(left, right) for component in pair), *tail)


def read_console_packet(data):
    numbers = CONSOLE.unpack(data)
    names = ("sequence", "kind", "version")
    packet = dict(zip(names, numbers[:3]))
    packet["delta"] = [numbers[3:9:2], numbers[4:10:2]]
    packet["rotations"] = [numbers[9:17:2], numbers[10:18:2]]
    packet["buttons"], packet["grasp"] = numbers[17:19], numbers[19:21]
    packet["surgeon_mode"], packet["checksum"] = numbers[21:]
    return packet


def robot_packet(sequence, last_sequence, kind, version, fx, fy, fz, runlevel, jointflags):
    total = sum((sequence, last_sequence, kind, version, *fx, *fy, *fz, runlevel, jointflags))
    return ROBOT.pack(sequence, last_sequence, kind, version, *fx, *fy, *fz, runlevel, jointflags, int32(total))


def multiply(a, b):
    (ax, ay, az, aw), (bx, by, bz, bw) = a, b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def unit(quaternion):
    length = math.sqrt(sum(number * number for number in quaternion))
    return tuple(number / length for number in quaternion)


def inverse(quaternion):
    x, y, z, w = quaternion
    return (-x, -y, -z, w)


class Console:
    """Sends what remains between the hand's way and what was sent."""

    def __init__(self):
        self.sequence = 0
        self.sent_um = [[0, 0, 0], [0, 0, 0]]
        self.sent_rotation = [IDENTITY, IDENTITY]
        self.grip = [None, None]

    def command(self, hands, pedal, buttons=0):
        self.sequence += 1
        moves, turns = [], []
        for arm, hand in enumerate(hands):
            position, rotation = hand["position"], tuple(hand["rotation"])
            if not pedal:
                self.grip[arm] = None
                moves.append([0, 0, 0])
                turns.append(IDENTITY)
                continue
            if self.grip[arm] is None:
                self.grip[arm] = (position, rotation, list(self.sent_um[arm]), self.sent_rotation[arm])
            held_position, held_rotation, base_um, base_rotation = self.grip[arm]
            move = []
            for axis in range(3):
                wanted = base_um[axis] + round((position[axis] - held_position[axis]) * 1e6)
                move.append(wanted - self.sent_um[arm][axis])
                self.sent_um[arm][axis] = wanted
            wanted = multiply(multiply(rotation, inverse(held_rotation)), base_rotation)
            turn = unit(multiply(wanted, inverse(self.sent_rotation[arm])))
            self.sent_rotation[arm] = unit(multiply(turn, self.sent_rotation[arm]))
            moves.append(move)
            turns.append(turn)
        delx, dely, delz = zip(*moves)
        mode = 1 if pedal else 0
        return console_packet(self.sequence, 0, 0, delx, dely, delz, turns, (buttons, buttons), (0, 0), mode)


class Robot:
    """Judges and adds up as the Raven II does: one step ahead is applied, all else is not."""

    def __init__(self):
        self.sequence = 0
        self.last_sequence = 0
        self.replies = 0
        self.position_um = [[0, 0, 0], [0, 0, 0]]
        self.rotation = [IDENTITY, IDENTITY]
        self.jaw_mrad = [0, 0]
        self.buttons = [0, 0]
        self.pedal = False
        self.stopped = False

    def receive(self, data):
        if len(data) != CONSOLE.size:
            return "malformed"
        packet = read_console_packet(data)
        number = packet["sequence"]
        if number == 0:
            return "question"
        if number > self.sequence + 1:
            self.sequence = number
            return "gap"
        if number == self.sequence:
            return "duplicate"
        if number == self.sequence + 1:
            self.sequence = self.last_sequence = number
            self.apply(packet)
            return "applied"
        if number < self.sequence - 1000:
            self.sequence = number
            return "reset"
        return "out of order"

    def apply(self, packet):
        self.pedal = packet["surgeon_mode"] == 1 and not self.stopped
        self.buttons = list(packet["buttons"]) if self.pedal else [0, 0]
        if not self.pedal:
            return
        for arm in range(2):
            for axis in range(3):
                self.position_um[arm][axis] += packet["delta"][arm][axis]
            self.rotation[arm] = unit(multiply(packet["rotations"][arm], self.rotation[arm]))
            jaw = self.jaw_mrad[arm] - packet["grasp"][arm]
            self.jaw_mrad[arm] = min(max(jaw, JAW_MRAD[0]), JAW_MRAD[1])

    def runlevel(self):
        return 0 if self.stopped else 3 if self.pedal else 2

    def reply(self):
        """Its forces are those of a spring of 100 N/m that pulls both arms to where they began."""
        self.replies += 1
        fx, fy, fz = ([int(-0.1 * arm[axis]) for arm in self.position_um] for axis in range(3))
        return robot_packet(self.replies, self.last_sequence, 0, 0, fx, fy, fz, self.runlevel(), 0)

    def report(self, verdict):
        return {
            "verdict": verdict,
            "position_um": self.position_um,
            "rotation": self.rotation,
            "jaw_mrad": self.jaw_mrad,
            "buttons": self.buttons,
            "runlevel": self.runlevel(),
            "reply": self.reply().hex(),
        }


def golden():
    """Packets of which every field has another number, and those at the ends of the numbers' ranges."""
    half = math.sqrt(0.5)
    yield "rest", console_packet(1, 0, 0, (0, 0), (0, 0), (0, 0), (IDENTITY, IDENTITY), (0, 0), (0, 0), 0)
    yield "fields", console_packet(
        0x01020304, 5, 6, (11, -12), (13, -14), (15, -16),
        ((0.125, 0.25, 0.375, 0.5), (-0.125, -0.25, -0.375, -0.5)), (17, 18), (-1900, 2000), 1)
    yield "sum over the end", console_packet(
        0xFFFFFFFF, 0, 0, (0x7FFFFFFF, 0x7FFFFFFF), (0x7FFFFFFF, 1), (2, 3),
        ((half, 0.0, 0.0, half), (0.0, 0.0, -half, half)), (0x7FFFFFFF, -1), (32767, -32768), 1)
    yield "sum below the start", console_packet(
        0x80000000, 0, 0, (-0x80000000, -0x80000000), (-0x80000000, -1), (-0x80000000, -7),
        (IDENTITY, IDENTITY), (-0x80000000, 0), (0, 0), 0)
    yield "matrices", console_packet(
        7, 8, 9, (1, 2), (3, 4), (5, 6),
        ((0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0)),
        (10, 20), (30, 40), 1)
    yield "reply", robot_packet(21, 22, 23, 24, (25, -26), (27, -28), (29, -30), 3, 0x8001)
    yield "reply over the end", robot_packet(
        0xFFFFFFFF, 0xFFFFFFFE, 0, 0, (0x7FFFFFFF, 0x7FFFFFFF), (0x7FFFFFFF, -0x80000000), (1, 1), 2, 0xFFFFFFFF)


def selftest():
    def check(holds, what):
        if not holds:
            sys.exit(f"itp_peer.py: {what}")

    check((CONSOLE.size, MATRIX_CONSOLE.size, ROBOT.size) == (124, 204, 52), "sizes")
    data = dict(golden())["fields"]
    offsets = {0: "<I", 4: "<I", 8: "<I", 12: "<2i", 20: "<2i", 28: "<2i", 36: "<2d", 52: "<2d", 68: "<2d", 84: "<2d",
               100: "<2i", 108: "<2i", 116: "<i", 120: "<i"}
    parts = [number for at, form in offsets.items() for number in struct.unpack_from(form, data, at)]
    check(tuple(parts) == CONSOLE.unpack(data), "offsets")
    check(parts[-1] == 0x01020304 + 11 - 12 + 13 - 14 + 15 - 16 + 17 + 18 + 1, "checksum")
    check((int32(0x80000000), int32(-1), int32(1 << 32)) == (-0x80000000, -1, 0), "wrapping")
    console, robot = Console(), Robot()
    for step in range(500):
        hand = {"position": [0.01 * math.sin(step / 50.0), 1e-7 * step, 0.0],
                "rotation": [math.sin(step / 1000.0), 0.0, 0.0, math.cos(step / 1000.0)]}
        check(robot.receive(console.command([hand, hand], step > 10)) == "applied", f"step {step}")
    check(robot.position_um == console.sent_um, "sums of increments")
    apart = multiply(robot.rotation[0], inverse(console.sent_rotation[0]))
    check(abs(apart[3]) > 1.0 - 1e-12 and abs(robot.rotation[0][0]) > 0.4, "sums of rotations")


def motion(secs):
    """A hand that draws a circle of 2 cm and turns to and fro."""
    angle, tilt = 2.0 * math.pi * 0.5 * secs, 0.15 * math.sin(secs)
    return {"position": [0.02 * math.sin(angle), 0.02 * (1.0 - math.cos(angle)), 0.0],
            "rotation": [math.sin(tilt), 0.0, 0.0, math.cos(tilt)]}


def console_over_udp(port, packets, hz, press):
    console = Console()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.connect(("127.0.0.1", port))
        link.setblocking(False)
        start = time.monotonic()
        for step in range(packets):
            hand = motion(step / hz)
            bits, begin, end = press
            buttons = bits if begin <= step < end else 0
            link.send(console.command([hand, hand], step > 10, buttons))
            time.sleep(max(0.0, start + (step + 1) / hz - time.monotonic()))
            try:
                while True:
                    reply = ROBOT.unpack(link.recv(2048))
                    print(json.dumps({"sequence": reply[0], "last_sequence": reply[1], "force_mn": reply[4:10],
                                      "runlevel": reply[10]}), flush=True)
            except (BlockingIOError, ConnectionRefusedError, struct.error):
                pass
    print(json.dumps({"sent": console.sequence, "position_um": console.sent_um}), flush=True)


def robot_over_udp(port, packets, stop):
    robot = Robot()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", port))
        link.settimeout(20.0)
        print(json.dumps({"port": link.getsockname()[1]}), flush=True)
        for number in range(packets):
            robot.stopped = stop[0] <= number < stop[1]
            try:
                data, peer = link.recvfrom(2048)
            except TimeoutError:
                break
            report = robot.report(robot.receive(data))
            link.sendto(bytes.fromhex(report["reply"]), peer)
            print(json.dumps(report), flush=True)


def main():
    asked = argparse.ArgumentParser(description="a console and a robot of ITP")
    asked.add_argument("mode", choices=["selftest", "emit", "console", "robot"])
    asked.add_argument("--udp", type=int, metavar="PORT", help="over the loopback address instead of standard input")
    asked.add_argument("--packets", type=int, default=5000, help="packets to send or to hear")
    asked.add_argument("--hz", type=float, default=1000.0, help="packets a second")
    asked.add_argument("--press", type=int, nargs=3, default=(0, 0, 0), metavar=("BITS", "FROM", "TO"), help="buttons")
    asked.add_argument("--stop", type=int, nargs=2, default=(0, 0), metavar=("FROM", "TO"), help="emergency stop")
    asked = asked.parse_args()
    if asked.mode == "selftest":
        selftest()
    elif asked.mode == "emit":
        for name, data in golden():
            print(json.dumps({"name": name, "bytes": len(data), "hex": data.hex()}))
    elif asked.mode == "console" and asked.udp is not None:
        console_over_udp(asked.udp, asked.packets, asked.hz, asked.press)
    elif asked.mode == "robot" and asked.udp is not None:
        robot_over_udp(asked.udp, asked.packets, asked.stop)
    elif asked.mode == "console":
        console = Console()
        for line in sys.stdin:
            hands = json.loads(line)
            print(json.dumps({"hex": console.command(hands["hands"], hands["pedal"]).hex()}), flush=True)
    else:
        robot = Robot()
        for line in sys.stdin:
            print(json.dumps(robot.report(robot.receive(bytes.fromhex(line.strip())))), flush=True)


if __name__ == "__main__":
    main()

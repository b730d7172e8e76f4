#!/bin/sh
# feetech-servo-ts 1.0.0 (npm), a servo client for browsers, told that the servo is an STS3215. Needs Node.js.
#
# Expected: writePosition(id, position, speed) sends both numbers, or refuses them.
# Seen: a speed above 1023 is sent as 1023 without a word (3000 counts/s become a third of that; 1023 is
# the largest speed of the older SCS servos), and a position of -500 is sent as 0, 44 deg elsewhere, although
# these servos take signed goals. A servo that stands at -100 is read as 32868, which is 2888.8 deg, and a load
# of -10 % as 1124.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm install --silent --no-fund --no-audit feetech-servo-ts@1.0.0
cat > talk.mjs <<'JS'
import assert from "node:assert";
import { FeetechServo } from "feetech-servo-ts";

const memory = new Uint8Array(80);
const written = {};
let answers;

function serve(packet) {
  const [kind, first, ...data] = packet.slice(4, -1);
  if (kind === 3) {
    memory.set(data, first);
    written[first] = data[0] + 256 * data[1];
  }
  const read = kind === 2 ? [...memory.slice(first, first + data[0])] : [];
  const body = [1, read.length + 2, 0, ...read];
  answers.enqueue(new Uint8Array([255, 255, ...body, ~body.reduce((a, b) => a + b) & 255]));
}

class Port extends EventTarget {
  async open() {
    let waiting = [];
    this.readable = new ReadableStream({ start: (controller) => { answers = controller; } });
    this.writable = new WritableStream({
      write(chunk) {
        waiting.push(...chunk);
        while (waiting.length >= 4 && waiting.length >= 4 + waiting[3]) serve(waiting.splice(0, 4 + waiting[3]));
      },
    });
  }
}

const serial = { requestPort: async () => new Port() };
Object.defineProperty(globalThis, "navigator", { value: { serial }, configurable: true });
const servo = new FeetechServo({ defaultModel: "sts3215" });
await servo.connect();
await servo.writePosition(1, 3000, 3000);
const [goal, speed] = [written[42], written[46]];
await servo.writePosition(1, -500);
memory.set([100, 128, 0, 0, 100, 4], 56);
const degrees = await servo.getPositionInDegrees(1);
const { load } = await servo.readStatus(1);
console.log({ goal, speed, negativeGoal: written[42], degreesAtMinus100: degrees, loadAtMinus10Percent: load });
assert.deepEqual([goal, speed, written[42], load], [3000, 1023, 0, 1124]);
assert(degrees > 2888 && degrees < 2889);
process.exit(0);
JS
node talk.mjs

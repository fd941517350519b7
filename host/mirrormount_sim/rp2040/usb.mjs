// A USB host for the emulated board: it enumerates the device, opens its CDC ports, and moves bytes.
// The host may stop collecting (`collects = false`), as when no program reads the port. Of a drive it knows only how to
// eject it; keyboards and other things that a device may be as well, it leaves alone.

const PACKET = 64;
const [CONTROL, DRIVE, BULK] = [2, 8, 10]; // interface classes: CDC's control and data, mass storage
// a command block wrapper (USB mass storage, bulk only, 5.1) with SCSI's START STOP UNIT: stop, and out with it
const EJECT = [0x55, 0x53, 0x42, 0x43, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 6, 0x1b, 0, 0, 0, 2, ...new Array(11).fill(0)];
const RECOVERY_NS = 10_000_000; // that a device has after a reset of the bus (USB 2.0, 7.1.7.5)
const STATUS_GAP_NS = 300_000; // after a control transfer, as the next frame of a real host

// One CDC port: what waits for the board, and what of the board waits.
class CdcPort {
  constructor(controlInterface) {
    this.interface = controlInterface;
    this.inEndpoint = this.outEndpoint = -1;
    this.outgoing = []; // bytes for the board
    this.asked = []; // sizes of the packets that the board is ready for
    this.refused = []; // packets of the board that were not collected
  }
}

export class CdcHost {
  // onData(data, number): what the board has sent. Port 0 is the last CDC port that the device has: the firmware's on
  // every board. Where there are two, CircuitPython's console comes first; it is port 1 here.
  constructor(controller, clock) {
    this.controller = controller;
    this.clock = clock;
    this.onData = () => {};
    this.onConfigured = () => {};
    this.onLanded = () => {}; // a packet is in the board's memory, for port 0
    this.collects = true; // these two are about port 0
    this.open = true; // DTR
    this.configured = false;
    this.ports = [];
    this.driveEndpoint = -1; // out
    this.queue = [];
    this.current = null;
    controller.onUSBEnabled = () => controller.resetDevice();
    const recovered = clock.createAlarm(() => this.enumerate());
    controller.onResetReceived = () => recovered.schedule(RECOVERY_NS);
    controller.onEndpointWrite = (endpoint, data) => this.fromDevice(endpoint, data);
    controller.onEndpointRead = (endpoint, size) => this.deviceReady(endpoint, size);
    const finish = controller.finishRead.bind(controller);
    controller.finishRead = (endpoint, data) => {
      finish(endpoint, data);
      if (endpoint === this.ports[0]?.outEndpoint) this.onLanded();
    };
    const indicate = controller.indicateBufferReady.bind(controller);
    controller.indicateBufferReady = (endpoint, out) => {
      const port = this.ports[0];
      if (!out && endpoint === port?.inEndpoint && !this.collects) port.refused.push(() => indicate(endpoint, out));
      else indicate(endpoint, out);
    };
    this.gap = clock.createAlarm(() => {
      const done = this.current;
      this.current = null;
      done?.then?.(done.got);
      this.nextControl();
    });
  }

  setCollects(yes) {
    this.collects = yes;
    if (yes) for (const go of this.ports[0]?.refused.splice(0) ?? []) go();
  }
  setOpen(yes) {
    this.open = yes;
    if (this.configured) this.setLine(this.ports[0], yes);
  }
  setLine(port, open, then) { this.control(0x21, 0x22, open ? 3 : 0, port.interface, 0, null, then); }
  get waiting() { return this.ports[0]?.outgoing.length ?? 0; }
  send(byte, number = 0) { this.ports[number]?.outgoing.push(byte); }
  eject() { if (this.driveEndpoint >= 0) this.controller.endpointReadDone(this.driveEndpoint, Uint8Array.from(EJECT)); }
  pump() { // hand over what waits, a packet for each one that the board has asked for
    for (const { asked, outgoing, outEndpoint } of this.ports) {
      while (asked.length && outgoing.length) {
        const size = Math.min(asked.shift(), PACKET, outgoing.length);
        this.controller.endpointReadDone(outEndpoint, Uint8Array.from(outgoing.splice(0, size)));
      }
    }
  }

  control(type, request, value, index, length, data, then) {
    this.queue.push({ type, request, value, index, length, data, then, got: [] });
    this.nextControl();
  }
  nextControl() {
    if (this.current || !this.queue.length) return;
    const c = (this.current = this.queue.shift());
    c.stage = c.type & 0x80 ? 'in' : c.length ? 'out' : 'status';
    const words = [c.value, c.index, c.length].flatMap(w => [w & 255, w >> 8]);
    this.controller.sendSetupPacket(Uint8Array.from([c.type, c.request, ...words]));
  }
  controlDone() {
    this.current.stage = 'finished';
    this.gap.schedule(STATUS_GAP_NS);
  }
  fromDevice(endpoint, data) {
    const number = this.ports.findIndex(port => port.inEndpoint === endpoint);
    if (number >= 0) { this.onData(data, number); return; }
    const c = this.current;
    if (endpoint !== 0 || !c) return;
    if (c.stage === 'in') {
      c.got.push(...data);
      if (data.length < PACKET || c.got.length >= c.length) {
        c.stage = 'acknowledge';
        if (this.controlOutReady) {
          this.controlOutReady = false;
          this.controller.endpointReadDone(0, new Uint8Array(0));
          this.controlDone();
        }
      }
    } else if (c.stage === 'status' && data.length === 0) this.controlDone();
  }
  deviceReady(endpoint, size) {
    const port = this.ports.find(port => port.outEndpoint === endpoint);
    if (port) { port.asked.push(size); this.pump(); return; }
    if (endpoint !== 0) return;
    const c = this.current;
    if (c?.stage === 'out') {
      this.controller.endpointReadDone(0, Uint8Array.from(c.data));
      c.stage = 'status';
    } else if (c?.stage === 'acknowledge') {
      this.controller.endpointReadDone(0, new Uint8Array(0));
      this.controlDone();
    } else this.controlOutReady = true;
  }

  enumerate() {
    this.queue = [];
    this.current = null;
    this.configured = false;
    this.controlOutReady = false;
    this.ports = [];
    this.control(0x00, 5, 1, 0, 0); // address 1
    this.control(0x80, 6, 0x0200, 0, 9, null, head => {
      this.control(0x80, 6, 0x0200, 0, head[2] | (head[3] << 8), null, all => this.configure(all));
    });
  }
  configure(descriptors) {
    for (let i = 0, kind = -1; i < descriptors.length && descriptors[i]; i += descriptors[i]) {
      if (descriptors[i + 1] === 4) {
        kind = descriptors[i + 5];
        if (kind === CONTROL) this.ports.unshift(new CdcPort(descriptors[i + 2]));
      } else if (descriptors[i + 1] === 5) {
        const address = descriptors[i + 2];
        if (kind === DRIVE && !(address & 0x80)) this.driveEndpoint = address;
        if (kind !== BULK) continue;
        if (address & 0x80) this.ports[0].inEndpoint = address & 15;
        else this.ports[0].outEndpoint = address & 15;
      }
    }
    this.control(0x00, 9, 1, 0, 0, null, () => this.openPorts(this.ports.length - 1));
  }
  openPorts(number) {
    if (number < 0) {
      this.configured = true;
      this.onConfigured();
      return;
    }
    const port = this.ports[number];
    this.control(0x21, 0x20, 0, port.interface, 7, [0x00, 0xc2, 0x01, 0, 0, 0, 8]); // 115200 8N1
    this.setLine(port, number > 0 || this.open, () => this.openPorts(number - 1));
  }
}

// A USB host for the emulated board: it enumerates the device, opens its CDC port, and moves bytes.
// The host may stop collecting (`collects = false`), as when no program reads the port.

const PACKET = 64;
const STATUS_GAP_NS = 300_000; // after a control transfer, as the next frame of a real host

export class CdcHost {
  constructor(controller, clock) {
    this.controller = controller;
    this.clock = clock;
    this.onData = () => {};
    this.onConfigured = () => {};
    this.collects = true;
    this.open = true; // DTR
    this.configured = false;
    this.outgoing = []; // bytes for the board
    this.asked = []; // sizes of the packets that the board is ready for
    this.refused = []; // packets of the board that were not collected
    this.queue = [];
    this.current = null;
    this.inEndpoint = this.outEndpoint = -1;
    this.interface = 0;
    controller.onUSBEnabled = () => controller.resetDevice();
    controller.onResetReceived = () => this.enumerate();
    controller.onEndpointWrite = (endpoint, data) => this.fromDevice(endpoint, data);
    controller.onEndpointRead = (endpoint, size) => this.deviceReady(endpoint, size);
    const indicate = controller.indicateBufferReady.bind(controller);
    controller.indicateBufferReady = (endpoint, out) => {
      if (!out && endpoint === this.inEndpoint && !this.collects) this.refused.push(() => indicate(endpoint, out));
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
    if (yes) for (const go of this.refused.splice(0)) go();
  }
  setOpen(yes) {
    this.open = yes;
    if (this.configured) this.control(0x21, 0x22, yes ? 3 : 0, this.interface, 0);
  }
  send(byte) { this.outgoing.push(byte); }
  pump() { // hand over what waits, a packet for each one that the board has asked for
    while (this.asked.length && this.outgoing.length) {
      const size = Math.min(this.asked.shift(), PACKET, this.outgoing.length);
      this.controller.endpointReadDone(this.outEndpoint, Uint8Array.from(this.outgoing.splice(0, size)));
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
    if (endpoint === this.inEndpoint) { this.onData(data); return; }
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
    if (endpoint === this.outEndpoint) { this.asked.push(size); this.pump(); return; }
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
    this.asked = [];
    this.refused = [];
    this.outgoing = [];
    this.control(0x00, 5, 1, 0, 0); // address 1
    this.control(0x80, 6, 0x0200, 0, 9, null, head => {
      this.control(0x80, 6, 0x0200, 0, head[2] | (head[3] << 8), null, all => this.configure(all));
    });
  }
  configure(descriptors) {
    for (let i = 0, kind = -1; i < descriptors.length && descriptors[i]; i += descriptors[i]) {
      if (descriptors[i + 1] === 4) {
        kind = descriptors[i + 5];
        if (kind === 2) this.interface = descriptors[i + 2];
      } else if (descriptors[i + 1] === 5 && kind === 10) {
        const address = descriptors[i + 2];
        if (address & 0x80) this.inEndpoint = address & 15;
        else this.outEndpoint = address & 15;
      }
    }
    this.control(0x00, 9, 1, 0, 0, null, () => {
      this.control(0x21, 0x20, 0, this.interface, 7, [0x00, 0xc2, 0x01, 0, 0, 0, 8]); // 115200 8N1
      this.control(0x21, 0x22, this.open ? 3 : 0, this.interface, 0, null, () => {
        this.configured = true;
        this.onConfigured();
      });
    });
  }
}

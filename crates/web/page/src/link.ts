// The socket: pictures in, signs of life and requests out. A sign of life is sent only for a picture that was drawn, so a page
// that hangs, is hidden or asleep gives none.
import { read, type Picture } from "./picture";

const BEAT_MS = 45;
const RETRY_MS = 500;

export interface State {
  you: string; role: "viewer" | "operator" | "maintainer"; holder: string | null; down: string | null; name: string | null;
  simulated: boolean; mode: string; moves: boolean; law: string | null; fault: { text: string; remedy: string } | null;
  uncalibrated: string | null; notice: string; size: [number, number, number] | null; taxels: [number, number][] | null;
  calibration: Calibration | null; gripper: Gripper | null;
}
/** Ranges of a grasp, and the gripper's fault. */
export interface Gripper {
  width_m: [number, number]; force_n: [number, number]; mass_kg: [number, number];
  fault: { text: string; remedy: string } | null;
}
export interface Calibration {
  step: string; text?: string; taxel?: number; done?: number; wanted?: number; force_n?: number | null;
  models?: { name: string; usable: boolean; rmse_n: number; worst_n: number }[];
}
export interface Reply { what: string; ok: boolean; text: string | null }
export type Ask = "tare" | "resume" | "cancel-calibration" | { law: string }
  | { gripper: "Release" | "Stop" | { Grasp: { width_m: number; speed_m_s: number; force_n: number; tolerance_m: number; mass_kg: number } } }
  | { "press-taxel": { taxel: number; force_n: number } }
  | { "mask-taxel": { taxel: number; masked: boolean } } | { "set-parameter": { name: string; values: number[] } }
  | { calibrate: { taxel: number; presses: number } } | { "save-calibration": { model: number } };

export class Link {
  picture: Picture | null = null;
  arrived = 0;
  drawn = 0;
  /** Press that holds now, 0 without one. */
  press = 0;
  roundTrip_ms = 0;
  bytes = 0;
  stops = 0;
  private presses = 0;
  private messages = 0;
  private sent = new Map<number, number>();
  private lastBeat = 0;
  private socket!: WebSocket;

  constructor(private on: { state(state: State): void; reply(reply: Reply): void; closed(why: string): void }) {
    this.connect();
  }

  get open(): boolean { return this.socket.readyState === WebSocket.OPEN; }

  private connect(): void {
    const socket = new WebSocket(`wss://${location.host}/socket`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      [this.messages, this.drawn, this.press, this.presses, this.stops, this.picture] = [0, 0, 0, 0, 0, null];
      this.sent.clear();
    };
    socket.onmessage = ({ data }: MessageEvent<ArrayBuffer | string>) => {
      if (typeof data !== "string") return this.see(data);
      this.bytes += data.length;
      const message = JSON.parse(data);
      if (message.t === "state") this.on.state(message as State);
      else if (message.t === "reply") this.on.reply(message as Reply);
    };
    socket.onclose = ({ reason }) => {
      this.press = 0;
      this.on.closed(reason);
      setTimeout(() => this.connect(), RETRY_MS);
    };
    this.socket = socket;
  }

  private see(data: ArrayBuffer): void {
    this.bytes += data.byteLength;
    this.picture = read(data);
    this.arrived = performance.now();
    const sent = this.sent.get(this.picture.heard);
    if (sent === undefined) return;
    this.roundTrip_ms = this.arrived - sent - this.picture.heardBefore;
    for (const n of this.sent.keys()) if (n <= this.picture.heard) this.sent.delete(n);
  }

  private send(message: object): void { if (this.open) this.socket.send(JSON.stringify(message)); }

  /** After each picture that was drawn; `now` without waiting for the next beat. */
  beat(now: number, atOnce = false): void {
    if (!this.open || !this.drawn || (!atOnce && now - this.lastBeat < BEAT_MS)) return;
    this.lastBeat = now;
    this.sent.set(++this.messages, now);
    this.send({ t: "beat", n: this.messages, drawn: this.drawn, press: this.press });
  }

  begin(now: number): void { this.press = ++this.presses; this.beat(now, true); }

  end(now: number): void { this.press = 0; this.beat(now, true); }

  ask(what: Ask): void { this.send({ t: "ask", n: ++this.messages, drawn: this.drawn, what }); }

  /** Returns the number that a picture confirms. */
  stop(): number {
    this.press = 0;
    this.send({ t: "stop", stop: ++this.stops });
    // A second way, in case the socket is stuck; it outlives the page.
    fetch("/stop", { method: "POST", keepalive: true }).catch(() => {});
    return this.stops;
  }
}

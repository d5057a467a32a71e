// One picture of the robot, as crates/web/src/picture.rs writes it.
export const MODES = ["starting", "taring", "ready", "impedance", "follow-me", "protective stop", "fault"];
export const STATUSES = ["ok", "not tared", "stale", "at its end", "stuck", "dead", "noisy", "drifted", "masked"];
export const REASONS = ["configured", "board rate", "stale data", "overridden", "contact", "late base"];
export const PHASES = ["resting", "moving", "holding", "unknown"];
const VERSION = 1;

export interface Picture {
  mode: number;
  live: boolean;
  holder: "nobody" | "this page" | "another";
  number: number;
  /** Newest message of this page that the gateway has heard, and how long before it sent this picture, ms. */
  heard: number;
  heardBefore: number;
  stopConfirmed: number;
  time_s: number;
  limitReason: number;
  pose: number[];
  speed: number;
  limit: number;
  coverAge_s: number;
  coverRate_hz: number;
  joints: number[];
  force_n: number[];
  status: number[];
  gripper: Fingers | null;
}

/** The gripper: distance between its fingers, mass of the object that the arm carries (0: none, or not told). */
export interface Fingers { width_m: number; object_kg: number; phase: number }

export function read(buffer: ArrayBuffer): Picture {
  const view = new DataView(buffer);
  if (view.getUint8(0) !== VERSION) throw new Error("The page is older than the gateway: load it again.");
  const flags = view.getUint8(3);
  const [taxels, joints] = [view.getUint8(28), view.getUint8(29)];
  let at = 32;
  const floats = (count: number) => Array.from({ length: count }, () => view.getFloat32((at += 4) - 4, true));
  const pose = floats(3);
  floats(3);
  const [speed = 0, limit = 0, coverAge_s = 0, coverRate_hz = 0] = floats(4);
  floats(3);
  const angles = floats(joints);
  const force_n = floats(taxels);
  const status = Array.from({ length: taxels }, () => view.getUint8(at++));
  const gripper = () => {
    const [width_m = 0, object_kg = 0] = floats(2);
    return { width_m, object_kg, phase: view.getUint8(at) };
  };
  return {
    mode: view.getUint8(1),
    live: (flags & 1) !== 0,
    holder: flags & 2 ? "this page" : flags & 4 ? "another" : "nobody",
    number: view.getUint32(4, true),
    heard: view.getUint32(8, true),
    heardBefore: view.getUint16(12, true) / 10,
    stopConfirmed: view.getUint32(16, true),
    time_s: view.getFloat64(20, true),
    limitReason: view.getUint8(30),
    pose, speed, limit, coverAge_s, coverRate_hz, joints: angles, force_n, status, gripper: flags & 8 ? gripper() : null,
  };
}

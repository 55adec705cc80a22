// What may be believed: the state that stands in the band, in words, from the worst down. Pure.

export const OLD_S = 1;            // A frame older than this is no real-time heave.
const DIVERGED = 2;                // Times what the standard deviations say, over ...
const DIVERGED_S = 60;             // ... so long, at the least.
const WORST_M = 0.02;              // Less is nobody's concern.

const MARKS = { good: "✔", caution: "▲", settling: "◔", alarm: "✖" };
const SERVER = {
  full: "as many browsers show the page as are served: close one",
  connecting: "connecting to the server of this page",
};

export const lasting = (span_s) => span_s < 1 ? `${Math.round(span_s * 1000)} ms`
  : span_s < 10 ? `${span_s.toFixed(1)} s`
  : span_s < 120 ? `${Math.floor(span_s)} s`
  : span_s < 7200 ? `${Math.floor(span_s / 60)} min`
  : `${Math.floor(span_s / 3600)} h`;

// level; show: "all", "soft" (not for use) or "none"; title, reason; also: lesser things.
export function judge({ isSilent, silent_s, trouble, link, motion, age_s, status, divergence }) {
  const say = (level, show, title, reason, also = []) => ({ level, show, title, reason, also, mark: MARKS[level] });
  if (isSilent) {
    const since = silent_s > OLD_S && !SERVER[trouble] ? ` for ${lasting(silent_s)}` : "";
    return say("alarm", "none", "NO CONNECTION", SERVER[trouble]
      ?? `the server of this page says nothing${since}: is heaved page running, and the network up?`);
  }
  if (link === null || !link.is_up) {
    return say("alarm", "none", "NO DAEMON", `${link?.trouble || "not connected yet"} (trying again)`);
  }
  if (motion === null) return say("alarm", "none", "NO DATA", "connected, but no frame has come");
  if (age_s > OLD_S) return say("alarm", "none", `DATA ${lasting(age_s)} OLD`, "connected, but nothing new comes", lesser({ status }));
  const quality = motion.quality ?? {};
  const reasons = [...(quality.reasons ?? [])];
  const first = reasons.shift() ?? "";
  const also = [...reasons, ...lesser({ status, divergence, motion })];
  if (quality.heave === "invalid") return say("alarm", "none", "HEAVE INVALID", first, also);
  if (quality.heave === "settling") return say("settling", "soft", "SETTLING", `${first.replace(/^settling: /, "") || "not settled yet"} – not for use`, also);
  if (motion.heave_m === undefined) return say("alarm", "none", "NO HEAVE", first, also);
  if (quality.heave === "degraded") return say("caution", "all", "DEGRADED", first, also);
  if (quality.heave !== "valid") return say("alarm", "none", "NOT UNDERSTOOD", `heave is "${quality.heave}": update heaved page`, also);
  const [worst, ...rest] = lesser({ status, divergence, motion });
  if (worst !== undefined) return say("caution", "all", "HEAVE VALID, BUT", worst, [...rest, first, ...reasons].filter(Boolean));
  return say("good", "all", "HEAVE VALID", first, reasons);
}

// What does not touch the heave, or not yet, but has to be seen.
function lesser({ status, divergence, motion }) {
  const found = [];
  for (const device of status?.devices ?? []) if (!device.up) found.push(`${device.name} is DOWN`);
  for (const output of status?.outputs ?? []) if (!output.up) found.push(`output ${output.name} is DOWN`);
  for (const point of motion?.points ?? []) if (point.state && point.state !== "valid") found.push(`${point.name}: ${point.state}`);
  for (const text of status?.reference_mru?.warnings ?? []) found.push(text);
  if (isDiverged(divergence)) found.push(`heave was off by ${divergence.rms_m.toFixed(2)} m against the delayed heave`);
  return found;
}

export function isDiverged(divergence) {
  return Boolean(divergence) && divergence.span_s >= DIVERGED_S && divergence.rms_m > WORST_M
    && divergence.rms_m > DIVERGED * divergence.expected_m;
}

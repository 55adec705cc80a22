// The page itself: puts what the feed has into words and numbers. Text of devices and of the daemon is only ever text.

import { Feed } from "./feed.js";
import { isDiverged, judge, lasting } from "./alarms.js";
import { AttitudePlot, HeavePlot, SpectrumPlot } from "./plots.js";

const TICK_MS = 100;
const DRAW_S = { 60: 0.1, 120: 0.2, 600: 0.5 };
const OLD_STATUS_S = 5;
const THEMES = ["day", "night", "contrast"];
const NOT_KNOWN = "–";

const at = (id) => document.getElementById(id);
const isNumber = (value) => typeof value === "number" && Number.isFinite(value);

// Writes only what has changed: a screen reader is told of changes, and a tablet has other things to do.
function put(element, text) { if (element.textContent !== text) element.textContent = text; }

const signed = (value, decimals) => {
  if (!isNumber(value)) return NOT_KNOWN;
  const digits = Math.abs(value).toFixed(decimals);
  return `${value < 0 && Number(digits) !== 0 ? "−" : "+"}${digits}`;
};
const plain = (value, decimals, unit = "") => isNumber(value) ? `${value.toFixed(decimals)}${unit}` : NOT_KNOWN;

// A list whose items are made of texts alone: rows of [class, text, text, ...].
function fill(list, rows, cell = "span") {
  const words = JSON.stringify(rows);
  if (list.dataset.words === words) return;
  list.dataset.words = words;
  list.replaceChildren(...rows.map(([kind, ...texts]) => {
    const item = document.createElement(list.tagName === "TBODY" ? "tr" : "li");
    item.className = kind;
    item.append(...texts.map((text) => {
      const part = document.createElement(cell);
      part.textContent = text;
      return part;
    }));
    return item;
  }));
}

// ---- choices ----

function remembered(name, choices) {
  try { const kept = localStorage.getItem(`heaved-${name}`); return choices.includes(kept) ? kept : choices[0]; } catch { return choices[0]; }
}

function remember(name, choice) {
  try { localStorage.setItem(`heaved-${name}`, choice); } catch { /* A browser that keeps nothing shows it all the same. */ }
}

let span_s = Number(remembered("span", ["60", "120", "600"]));

function choose(theme) {
  remember("theme", theme);
  document.documentElement.dataset.theme = theme;
  for (const button of document.querySelectorAll("[data-choose]")) button.setAttribute("aria-pressed", button.dataset.choose === theme);
  for (const plot of plots) plot.restyle();
  drawn_s = -Infinity;
}

function span(seconds) {
  span_s = seconds;
  remember("span", String(seconds));
  for (const button of document.querySelectorAll("[data-span]")) button.setAttribute("aria-pressed", Number(button.dataset.span) === seconds);
  put(at("span-name"), `${seconds / 60} min`);
  drawn_s = -Infinity;
}

function fullScreen() {
  if (document.fullscreenElement) document.exitFullscreen(); else document.documentElement.requestFullscreen?.();
}

const KEYS = {
  1: () => span(60), 2: () => span(120), 0: () => span(600),
  d: () => choose("day"), n: () => choose("night"), c: () => choose("contrast"),
  f: fullScreen, h: () => at("help").showModal(), "?": () => at("help").showModal(),
};

// ---- what is shown ----

function showBand({ level, title, reason, also, mark }) {
  const band = at("band");
  if (band.className !== level) band.className = level;
  put(at("mark"), mark);
  put(at("title"), title);
  put(at("reason"), reason);
  fill(at("also"), also.slice(0, 3).map((text, row) => ["", row === 2 && also.length > 3 ? `${text} … and ${also.length - 3} more` : text]));
  document.title = level === "good" ? "heaved" : `${mark} ${title}`;
}

function showMotion(record, show) {
  const heave = show === "none" ? {} : record;
  put(at("heave-m"), signed(heave.heave_m, 2));
  at("heave-m").classList.toggle("long", at("heave-m").textContent.length > 5);
  put(at("heave-2std"), isNumber(heave.heave_std_m) ? (2 * heave.heave_std_m).toFixed(2) : NOT_KNOWN);
  put(at("heave-way"), Math.abs(heave.heave_velocity_mps) >= 0.005 ? (heave.heave_velocity_mps < 0 ? "▼" : "▲") : "");
  put(at("heave-velocity"), signed(heave.heave_velocity_mps, 2));
  const lead_s = heave.compensation_lead_s;
  put(at("heave-caveat"), [show === "soft" ? "settling: not for use" : "", isNumber(lead_s) ? `of ${lasting(lead_s)} ahead` : ""].filter(Boolean).join("; "));
}

function showOther(record, isLive) {
  put(at("reference"), isLive ? `${isNumber(record.reference_m) ? `${signed(record.reference_m, 3)} m, ` : ""}${record.quality.laser}` : NOT_KNOWN);
  put(at("correction"), isLive ? `${isNumber(record.correction_m) ? `${signed(record.correction_m, 3)} m, ` : ""}${record.quality.correction}` : NOT_KNOWN);
  for (const axis of ["roll", "pitch"]) {
    put(at(axis), isLive && isNumber(record[`${axis}_deg`]) ? `${signed(record[`${axis}_deg`], 1)}°` : NOT_KNOWN);
    put(at(`${axis}-ahead`), isLive ? aheadInWords(record.rock ?? [], axis) : NOT_KNOWN);
  }
}

// The longest prediction that does not go beyond a second: what a person can still act on and may believe.
function aheadInWords(rock, axis) {
  const one = rock.filter((each) => isNumber(each[`${axis}_deg`]) && each.horizon_s <= 1).at(-1);
  if (one === undefined) return "no prediction";
  return `in ${lasting(one.horizon_s)} ${signed(one[`${axis}_deg`], 1)}° ± ${plain(one[`${axis}_interval_deg`] ?? 2 * one[`${axis}_std_deg`], 1)}°`;
}

function showPoints(record, show) {
  const points = record?.points ?? [];
  const isAbsent = points.length === 0 && (record !== null || at("point-rows").rows.length === 0);
  if (at("points").hidden !== isAbsent) { at("points").hidden = isAbsent; arrange(); }
  if (points.length === 0) { for (const row of at("point-rows").rows) for (const cell of [...row.cells].slice(1)) put(cell, NOT_KNOWN); delete at("point-rows").dataset.words; return; }
  fill(at("point-rows"), points.map((point) => {
    const isKnown = show !== "none" && point.state !== "invalid" && isNumber(point.heave_m);
    return [show === "soft" ? "soft" : "",
      [point.name, [point.state ?? "", ...(point.reasons ?? [])].filter(Boolean).join(": ")].filter(Boolean).join("\n"),
      isKnown ? signed(point.heave_m, 2) : NOT_KNOWN,
      [isKnown && isNumber(point.heave_std_m) ? `± ${(2 * point.heave_std_m).toFixed(2)} m` : "",
        isKnown ? `${signed(point.heave_velocity_mps, 2)} m/s` : ""].join("\n")];
  }), "td");
}

// The lowest row is shared by as many as there are.
function arrange() {
  document.querySelector("main").dataset.parts = String(2 + !at("points").hidden + !at("outputs").hidden);
}

function showSea(told, age_s) {
  const sea = told?.record;
  put(at("hs"), plain(sea?.significant_height_m, 1));
  put(at("tp"), sea?.is_still ? NOT_KNOWN : plain(sea?.peak_period_s, 1));
  put(at("tm"), sea?.is_still ? NOT_KNOWN : plain(sea?.mean_period_s, 1));
  put(at("sea-age"), sea ? `as of ${lasting(age_s)} ago${sea.is_still ? ", still" : ""}` : "not fitted since the page began to listen");
  fill(at("systems"), (sea?.systems ?? []).slice(0, 3).map((one) => ["", `${one.kind} ${plain(one.significant_height_m, 1)} m, ${plain(one.peak_period_s, 1)} s`]));
  spectrum.show(sea ?? null);
}

function showQuality(record, verdict) {
  if (!record) { put(at("quality-state"), NOT_KNOWN); fill(at("reasons"), []); return; }
  const { heave, reasons = [] } = record.quality;
  put(at("quality-state"), heave);
  const more = verdict.also.filter((text) => !reasons.includes(text));
  fill(at("reasons"), [...reasons, ...more].map((text) => ["", text]));
}

// An existing MRU beside ours: nothing of it is shown where there is none.
function showReferenceMru(mru) {
  for (const id of ["reference-mru-name", "reference-mru-row"]) at(id).hidden = !mru;
  if (!mru) return;
  put(at("reference-mru"), !isNumber(mru.age_s) ? "nothing to compare yet"
    : !isNumber(mru.compared_s) ? `nothing for ${lasting(mru.age_s)}`
    : `${signed(mru.heave_difference_m, 2)} m, ${plain(mru.heave_std_difference_m, 2, " m")} RMS in ${plain(mru.compared_s, 0, " s")}`);
}

// "(link, id 1): what is wrong" follows the device's name; without that there is more room for what to do.
function withoutPlace(device) {
  const detail = device.detail ?? "", [place, ...what] = detail.split("): ");
  return what.length && place.startsWith(`${device.name} (`) ? what.join("): ") : detail;
}

function showThings(status) {
  fill(at("device-rows"), (status?.devices ?? []).map((device) => [
    device.up ? "up" : "down",
    `${device.up ? "✔" : "✖"} ${device.name} (${device.role}) ${device.up ? "up" : "DOWN"}`,
    `${plain(device.rate_hz, 1)}${isNumber(device.wanted_rate_hz) ? ` of ${device.wanted_rate_hz}` : ""} Hz`
      + (device.last_fault ? `, last fault ${device.last_fault}${isNumber(device.last_fault_age_s) ? ` ${lasting(device.last_fault_age_s)} ago` : ""}` : ""),
    withoutPlace(device),
  ]));
  if (!status) fill(at("device-rows"), [["", NOT_KNOWN]]);
  const outputs = status?.outputs ?? [];
  if (at("outputs").hidden !== (outputs.length === 0)) { at("outputs").hidden = outputs.length === 0; arrange(); }
  fill(at("output-rows"), outputs.map((output) => [
    output.up ? "up" : "down",
    `${output.up ? "✔" : "✖"} ${output.name} (${output.kind}) ${output.up ? "up" : "DOWN"}`,
    `${output.sent ?? 0} sent${Object.entries(output.lost ?? {}).filter(([, count]) => count).map(([why, count]) => `, ${count} lost: ${why}`).join("")}`,
    output.detail ?? "",
  ]));
}

function quietInWords(quiet) {
  if (!quiet) return NOT_KNOWN;
  if (quiet.is_expected && isNumber(quiet.start_s)) {
    return `${quiet.start_s < 1 ? "now" : `in ${Math.round(quiet.start_s)} s`} for ${plain(quiet.length_s, 0)} s, ${plain(100 * quiet.confidence, 0)} % sure`;
  }
  return isNumber(quiet.best_confidence) ? `none sure enough (best ${plain(100 * quiet.best_confidence, 0)} %)` : "not known yet";
}

function show() {
  const now_s = feed.now_s();
  const { motion, link } = feed;
  const age_s = motion ? feed.age_s(motion.at_s) : Infinity;
  const isSilent = feed.isSilent();
  const status = feed.status && feed.age_s(feed.status.read_s) < OLD_STATUS_S ? feed.status.record : null;
  const verdict = judge({
    isSilent, silent_s: feed.silent_s(), trouble: feed.trouble, link, motion: motion?.record ?? null, age_s, status, divergence: feed.divergence,
  });
  const isConnected = !isSilent && Boolean(link?.is_up);
  const isFresh = isConnected && age_s <= 1;
  const record = isFresh ? motion.record : null;
  document.body.classList.toggle("withheld", !isFresh);
  document.body.classList.toggle("no-heave", verdict.show === "none");
  document.body.classList.toggle("soft", verdict.show === "soft");
  showBand(verdict);
  showMotion(record ?? {}, verdict.show);
  showOther(record ?? { quality: {} }, isFresh);
  showPoints(record, verdict.show);
  showSea(isConnected ? feed.sea : null, feed.sea ? feed.age_s(feed.sea.read_s) : 0);
  showQuality(record, verdict);
  showThings(isConnected ? status : null);
  showReferenceMru(isConnected ? status?.reference_mru : null);
  const told = isFresh ? feed.divergence : null;
  put(at("divergence"), told ? `${told.rms_m.toFixed(3)} m rms over ${lasting(told.span_s)}${isDiverged(told) ? " – more than it says" : ""}` : NOT_KNOWN);
  put(at("quiet"), quietInWords(isFresh && feed.quiet && feed.age_s(feed.quiet.read_s) < OLD_STATUS_S ? feed.quiet.record : null));
  put(at("age"), motion && now_s !== null ? lasting(age_s) : "not known");
  put(at("valid-at"), motion ? `${motion.record.time.slice(11, 21)} UTC` : NOT_KNOWN);
  const lost = feed.lost ? `, ${feed.lost} frames not shown` : "";
  put(at("where"), link ? `heaved ${link.release} at ${link.stream}${link.connections > 1 ? `, connection ${link.connections}` : ""}${lost}` : NOT_KNOWN);

  const clock_s = performance.now() / 1000;
  if (clock_s - drawn_s >= DRAW_S[span_s] - 0.02) {
    drawn_s = clock_s;
    const shown_s = now_s ?? 0;
    heave.show(feed.track, motion, shown_s, span_s, isFresh && verdict.show === "all");
    attitude.show(feed.track, motion, shown_s, span_s, isFresh);
  }
}

// ---- start ----

const heave = new HeavePlot(at("heave-plot")), attitude = new AttitudePlot(at("attitude-plot")), spectrum = new SpectrumPlot(at("spectrum-plot"));
const plots = [heave, attitude, spectrum];
let drawn_s = -Infinity;
choose(remembered("theme", THEMES));
span(span_s);
for (const button of document.querySelectorAll("[data-choose]")) button.addEventListener("click", () => choose(button.dataset.choose));
for (const button of document.querySelectorAll("[data-span]")) button.addEventListener("click", () => span(Number(button.dataset.span)));
at("full").addEventListener("click", fullScreen);
at("ask").addEventListener("click", () => at("help").showModal());
document.addEventListener("keydown", (event) => {
  if (!event.ctrlKey && !event.altKey && !event.metaKey && Object.hasOwn(KEYS, event.key)) { KEYS[event.key](); event.preventDefault(); }
});
const feed = new Feed();
// What we did not foresee must not leave numbers standing that look alive.
function beat() {
  try {
    feed.tick();
    show();
  } catch (error) {
    document.body.classList.add("withheld", "no-heave");
    showBand({ level: "alarm", mark: "✖", title: "PAGE FAULT", reason: `please report it: ${error}`, also: [] });
    for (const output of document.querySelectorAll("main output, main tbody, main ul, footer output")) {
      output.replaceChildren(NOT_KNOWN);
      delete output.dataset.words;
    }
  }
}

// Also before the browser paints what it may have kept from before it slept.
document.addEventListener("visibilitychange", beat);
setInterval(beat, TICK_MS);

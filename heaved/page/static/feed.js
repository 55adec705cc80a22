// What comes from the page's server, and how old it is. Nothing here is shown as new unless the server's own clock says
// that it is: a browser that slept, a tab that was frozen or a network that held back finds out, and starts afresh.

const SYNC_S = 5;               // The server's clock is asked for so often ...
const SYNCS = 6;                // ... and the best of so many answers counts.
const SLEPT_S = 3;              // Our own clockwork stood still for so long: nothing is known any more.
const SILENT_S = 2;             // The server sends twice a second; without a word for so long it is lost.
const AGAIN_S = 1;
const KEPT_S = 610;             // Of what is plotted.
const LIVE_S = 0.09;            // Between points that are kept.
const GAP_S = 1;                // Points further apart are not joined.

const seconds = () => performance.now() / 1000;

// Columns that are plotted, oldest first; times on the server's clock.
class Track {
  constructor() { this.at_s = []; this.lead_s = []; this.heave_m = []; this.heave_std_m = []; this.reference_m = []; this.roll_deg = []; this.pitch_deg = []; }

  push(row) {
    const last = this.at_s.at(-1);
    if (last !== undefined) {
      if (row.at_s - last < LIVE_S) return;
      if (row.at_s - last > GAP_S) this.#add({ at_s: last + 0.01 });
    }
    this.#add(row);
    if (this.at_s[0] < row.at_s - KEPT_S - 30) {
      const first = this.at_s.findIndex((at_s) => at_s >= row.at_s - KEPT_S);
      for (const column of Object.values(this)) column.splice(0, first);
    }
  }

  #add(row) {
    for (const [name, column] of Object.entries(this)) column.push(row[name] ?? null);
  }
}

export class Feed {
  constructor() {
    this.#forget();
    this.#open();
    this.ticked = Date.now();
    document.addEventListener("visibilitychange", () => {
      if (document.hidden) this.#close("the page was out of sight"); else this.#open();
    });
    window.addEventListener("pageshow", (event) => { if (event.persisted) this.#open(); });
  }

  // To be called ten times a second.
  tick() {
    const slept_s = (Date.now() - this.ticked) / 1000;
    this.ticked = Date.now();
    if (document.hidden) return;
    if (slept_s > SLEPT_S || slept_s < -SLEPT_S) this.#open();
    else if (this.source === null && seconds() > this.again_s) this.#open();
    else if (this.source !== null && this.silent_s() > SILENT_S + AGAIN_S) this.#open();
    if (this.source !== null && seconds() > this.sync_s) this.#sync();
  }

  // Since the server last said anything.
  silent_s() { return seconds() - this.heard_s; }

  isSilent() { return this.source === null || this.silent_s() > SILENT_S || this.bounds.length === 0; }

  // The server's clock, at the latest that it can be; null while that is not known.
  now_s() { return this.bounds.length === 0 ? null : seconds() + Math.min(...this.bounds); }

  // Of something that was valid at a time of that clock.
  age_s(at_s) { const now_s = this.now_s(); return now_s === null ? Infinity : Math.max(0, now_s - at_s); }

  #forget() {
    this.link = null;
    this.motion = null;         // { at_s, record }
    this.status = this.sea = this.delayed = this.quiet = this.divergence = null;
    this.track = new Track();
    this.lost = 0;
    this.bounds = [];
    this.sync_s = -Infinity;
  }

  #close(why) {
    if (this.source) this.source.close();
    this.source = null;
    this.trouble = why;
    this.again_s = seconds() + AGAIN_S;
    this.#forget();
  }

  #open() {
    this.#close(this.trouble ?? "connecting");
    const source = this.source = new EventSource("events");
    this.heard_s = seconds();
    const on = (name, take) => source.addEventListener(name, (event) => {
      if (source !== this.source) return;   // What an older connection still has to say.
      let told;
      try { told = JSON.parse(event.data); } catch { return; }
      this.heard_s = seconds();
      take(told);
    });
    source.onerror = () => {
      if (source !== this.source) return;
      const kept = this.trouble;
      this.#close(kept === "full" ? kept : "gone");
      this.#why();
    };
    on("clock", () => { this.trouble = null; });
    on("link", (link) => this.#linked(link));
    on("history", (columns) => this.#past(columns));
    on("motion", (told) => {
      this.lost += told.lost;
      for (const frame of told.frames) this.#frame(frame);
    });
    for (const name of ["status", "sea", "delayed", "quiet", "divergence"]) on(name, (told) => { this[name] = told; });
  }

  #linked(link) {
    if (this.page !== undefined && this.page !== link.page) location.reload();   // A newer heaved serves it.
    this.page = link.page;
    const isNew = this.link !== null && (this.link.is_up !== link.is_up || this.link.connections !== link.connections);
    this.link = link;
    if (isNew) {
      this.motion = null;
      this.status = this.sea = this.delayed = this.quiet = this.divergence = null;
    }
  }

  #past(columns) {
    const names = Object.keys(columns);
    this.track = new Track();
    columns.at_s.forEach((_, row) => this.track.push(Object.fromEntries(names.map((name) => [name, columns[name][row]]))));
  }

  #frame(frame) {
    this.motion = frame;
    const { record } = frame;
    const isInvalid = record.quality.heave === "invalid";
    this.track.push({
      at_s: frame.at_s, lead_s: record.compensation_lead_s ?? 0, heave_m: isInvalid ? null : record.heave_m,
      heave_std_m: record.heave_std_m, reference_m: record.reference_m, roll_deg: record.roll_deg, pitch_deg: record.pitch_deg,
    });
  }

  async #sync() {
    this.sync_s = seconds() + SYNC_S;
    const { source } = this;
    const asked_s = seconds();
    try {
      const told = await (await fetch("clock", { cache: "no-store", signal: AbortSignal.timeout(SILENT_S * 1000) })).json();
      if (source !== this.source) return;
      this.bounds.push(told.mono_s - asked_s);   // It was read after we asked: it cannot be later than this says.
      if (this.bounds.length > SYNCS) this.bounds.shift();
    } catch {
      if (source === this.source) { this.bounds.shift(); this.sync_s = seconds() + AGAIN_S; }
    }
  }

  // The browser does not tell why a connection failed; one reason can be asked for.
  async #why() {
    try {
      const told = await (await fetch("clock", { cache: "no-store", signal: AbortSignal.timeout(SILENT_S * 1000) })).json();
      if (told.viewers >= told.most_viewers) this.trouble = "full";
    } catch { this.trouble = "gone"; }
  }
}

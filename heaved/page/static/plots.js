// The three plots, on uPlot. Colours are those of the style sheet, so that day and night reach the canvas.

const AHEAD_S = 6;
const PERIODS_S = [30, 20, 15, 12, 10, 8, 7, 6, 5, 4, 3, 2.5, 2];
const HEIGHTS = [0.05, 0.1, 0.2, 0.5, 1, 1.5, 2, 3, 4, 5, 7, 10, 15, 20, 30, 50, 100];
const TICKS = { 60: 10, 120: 20, 600: 60 };
const APART = 90;              // Pixels between the names of two ticks, at the least.

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const isNumber = (value) => typeof value === "number" && Number.isFinite(value);

function firstAfter(times, at_s) {
  let low = 0, high = times.length;
  while (low < high) { const middle = (low + high) >> 1; if (times[middle] < at_s) low = middle + 1; else high = middle; }
  return low;
}

// The next round number above all that is shown, so that the scale seldom moves.
function scaleOf(columns, least) {
  let most = least;
  for (const column of columns) for (const value of column) if (isNumber(value) && Math.abs(value) > most) most = Math.abs(value);
  return HEIGHTS.find((height) => height >= most) ?? most;
}

class TimePlot {
  constructor(place, unit, series, bands) {
    this.place = place;
    this.unit = unit;
    this.series = series;
    this.bands = bands;
    this.now_s = 0;
    this.span_s = 60;
    this.scale = 1;
    this.restyle();
    new ResizeObserver(() => this.plot.setSize(this.#size())).observe(place);
  }

  // After the colours have changed.
  restyle() {
    this.plot?.destroy();
    const font = `16px ${getComputedStyle(document.body).fontFamily}`;
    const axis = { stroke: colour("fg"), grid: { stroke: colour("grid"), width: 1 }, ticks: { show: false }, font };
    this.plot = new uPlot({
      ...this.#size(),
      legend: { show: false },
      cursor: { show: false },
      padding: [8, 10, 0, 0],
      scales: {
        x: { time: false, range: () => [this.now_s - this.span_s, this.now_s + AHEAD_S] },
        y: { range: () => [-this.scale, this.scale] },
      },
      axes: [
        { ...axis, size: 28, splits: () => this.#ticks(), values: (_, at) => at.map((at_s) => this.#name(at_s - this.now_s)) },
        { ...axis, size: 62, splits: () => [-1, -0.5, 0, 0.5, 1].map((part) => part * this.scale),
          values: (_, at) => at.map((value) => value === 0 ? "0" : `${value > 0 ? "+" : "−"}${Number(Math.abs(value).toFixed(3))}`) },
      ],
      series: [{}, ...this.series.map(({ stroke, ...rest }) => ({ spanGaps: false, points: { show: false }, ...rest, stroke: stroke && colour(stroke),
        ...(rest.marks ? { points: { show: true, size: 9, width: 0, fill: colour(stroke), stroke: colour(stroke) } } : {}),
        ...(rest.dots ? { paths: () => null, points: { show: true, size: 9, width: 2, fill: colour("panel"), stroke: colour(stroke) } } : {}) }))],
      bands: this.bands.map(({ fill, ...rest }) => ({ ...rest, fill: colour(fill) })),
      hooks: { draw: [(plot) => this.#markNow(plot)] },
    }, [[], ...this.series.map(() => [])], this.place);
  }

  draw(now_s, span_s, data, scale) {
    Object.assign(this, { now_s, span_s, scale });
    this.plot.setData(data);
  }

  #size() { return { width: Math.max(50, this.place.clientWidth), height: Math.max(50, this.place.clientHeight) }; }

  #ticks() {
    const fit = this.place.clientWidth / APART;
    const step_s = TICKS[this.span_s] * ([1, 2, 3, 6].find((times) => this.span_s / TICKS[this.span_s] / times < fit) ?? 6);
    const back = Array.from({ length: Math.floor(this.span_s / step_s) + 1 }, (_, k) => this.now_s - k * step_s).reverse();
    const room = (5 / (this.span_s + AHEAD_S)) * (this.place.clientWidth - 70);
    return room > 46 ? [...back, this.now_s + 5] : back;
  }

  #name(from_s) {
    const rounded = Math.round(from_s);
    if (rounded === 0) return "now";
    return this.span_s < 600 ? `${rounded > 0 ? "+" : "−"}${Math.abs(rounded)} s` : `−${Math.abs(rounded) / 60} min`;
  }

  #markNow(plot) {
    const { ctx, bbox } = plot, x = Math.round(plot.valToPos(this.now_s, "x", true));
    ctx.save();
    ctx.strokeStyle = colour("fg");
    ctx.lineWidth = 2;
    ctx.setLineDash([]);
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    ctx.restore();
  }
}

const LINE = 3, HELD = { width: 0 };
const DOTS = 60;               // Of the laser: enough to see that it is there, not so many that they hide the heave.

function seldom(at_s, column, apart_s) {
  let last_s = -Infinity;
  return column.map((value, row) => {
    // On a raster of time, so that a dot stays where it is as the plot moves on.
    const raster_s = Math.floor(at_s[row] / apart_s);
    if (value === null || raster_s === last_s) return null;
    last_s = raster_s;
    return value;
  });
}

export class HeavePlot extends TimePlot {
  constructor(place) {
    super(place, "m", [
      { stroke: "laser", dots: true }, HELD, HELD, { stroke: "heave", width: LINE },
      HELD, HELD, { stroke: "forecast", width: LINE, dash: [8, 6], marks: true },
    ], [{ series: [3, 2], fill: "heave-band" }, { series: [6, 5], fill: "forecast-band" }]);
  }

  show(track, motion, now_s, span_s, isKnown) {
    const from = firstAfter(track.at_s, now_s - span_s - 2);
    const part = (column) => column.slice(from);
    const at_s = part(track.at_s).map((t_s, row) => t_s + (track.lead_s[from + row] ?? 0));
    const heave = part(track.heave_m), std = part(track.heave_std_m), laser = part(track.reference_m);
    const side = (sign) => heave.map((value, row) => value === null || std[row] === null ? null : value + sign * 2 * std[row]);
    const ahead = isKnown ? forecastOf(motion) : [];
    const none = (column) => column.map(() => null);
    const blank = ahead.map(() => null), past = none(at_s);
    const last = at_s.at(-1) ?? -Infinity;
    const later = ahead.filter((one) => one.at_s > last);
    blank.length = later.length;
    const data = [
      [...at_s, ...later.map((one) => one.at_s)],
      [...seldom(at_s, laser, span_s / DOTS), ...blank], [...side(-1), ...blank], [...side(1), ...blank], [...heave, ...blank],
      [...past, ...later.map((one) => one.low)], [...past, ...later.map((one) => one.high)], [...past, ...later.map((one) => one.value)],
    ];
    // The forecast goes on from the heave.
    if (later.length && at_s.length && heave.at(-1) !== null) for (const k of [5, 6, 7]) data[k][at_s.length - 1] = heave.at(-1);
    this.draw(now_s, span_s, data, scaleOf([data[1], data[2], data[3], data[5], data[6]], 0.05));
  }
}

function forecastOf({ at_s, record }) {
  return (record.forecast ?? []).filter((one) => isNumber(one.heave_m)).map((one) => {
    const spread = isNumber(one.std_m) ? 2 * one.std_m : 0;
    return { at_s: at_s + one.horizon_s, value: one.heave_m, low: one.heave_m - spread, high: one.heave_m + spread };
  });
}

export class AttitudePlot extends TimePlot {
  constructor(place) {
    super(place, "°", [
      { stroke: "roll", width: LINE }, { stroke: "pitch", width: LINE, dash: [10, 5] },
      HELD, HELD, { stroke: "roll", width: LINE }, HELD, HELD, { stroke: "pitch", width: LINE, dash: [10, 5] },
    ], [{ series: [4, 3], fill: "roll-band" }, { series: [7, 6], fill: "pitch-band" }]);
  }

  show(track, motion, now_s, span_s, isKnown) {
    const from = firstAfter(track.at_s, now_s - span_s - 2);
    const at_s = track.at_s.slice(from), roll = track.roll_deg.slice(from), pitch = track.pitch_deg.slice(from);
    const last = at_s.at(-1) ?? -Infinity;
    const rock = isKnown ? (motion.record.rock ?? []).filter((one) => motion.at_s + one.horizon_s > last) : [];
    const past = at_s.map(() => null), blank = rock.map(() => null);
    const ahead = (axis, sign) => rock.map((one) => isNumber(one[`${axis}_deg`])
      ? one[`${axis}_deg`] + sign * (one[`${axis}_interval_deg`] ?? 2 * (one[`${axis}_std_deg`] ?? 0)) : null);
    const data = [[...at_s, ...rock.map((one) => motion.at_s + one.horizon_s)], [...roll, ...blank], [...pitch, ...blank]];
    for (const axis of ["roll", "pitch"]) for (const sign of [-1, 1, 0]) data.push([...past, ...ahead(axis, sign)]);
    if (rock.length && at_s.length) {
      for (const k of [3, 4, 5]) data[k][at_s.length - 1] = roll.at(-1);
      for (const k of [6, 7, 8]) data[k][at_s.length - 1] = pitch.at(-1);
    }
    // The intervals of the longest predictions may be wide: they shall not make the motion itself small.
    const least = scaleOf([roll, pitch], 0.5), next = HEIGHTS[HEIGHTS.indexOf(least) + 1] ?? least;
    this.draw(now_s, span_s, data, Math.max(least, Math.min(scaleOf(data.slice(3), 0.5), next)));
  }
}

export class SpectrumPlot {
  constructor(place) {
    this.place = place;
    this.sea = null;
    this.restyle();
    new ResizeObserver(() => this.plot.setSize(this.#size())).observe(place);
  }

  restyle() {
    this.plot?.destroy();
    const font = `14px ${getComputedStyle(document.body).fontFamily}`;
    const axis = { stroke: colour("fg"), grid: { stroke: colour("grid"), width: 1 }, ticks: { show: false }, font };
    this.plot = new uPlot({
      ...this.#size(),
      legend: { show: false },
      cursor: { show: false },
      padding: [8, 10, 0, 0],
      scales: { x: { time: false, range: () => this.#range() }, y: { range: (_, __, most) => [0, most > 0 ? most * 1.1 : 1] } },
      axes: [
        { ...axis, size: 26, splits: () => this.#splits(), values: (_, at) => at.map((hz) => `${Number((1 / hz).toFixed(1))} s`) },
        { ...axis, size: 62, label: "m²/Hz", labelSize: 18, labelFont: font, values: (_, at) => at.map((value) => String(Number(value.toPrecision(3)))) },
      ],
      series: [{}, { stroke: colour("heave"), width: LINE, fill: colour("heave-band"), points: { show: false } }],
    }, this.#data(), this.place);
  }

  show(sea) {
    if (sea === this.sea) return;
    this.sea = sea;
    this.plot.setData(this.#data());
  }

  #data() { return this.sea ? [[...this.sea.frequencies_hz], [...this.sea.spectrum_m2phz]] : [[], []]; }

  #range() {
    const [hz, m2phz] = this.#data();
    if (hz.length === 0) return [0.03, 0.3];
    const most = Math.max(...m2phz);
    const last = m2phz.findLastIndex((value) => value > 0.005 * most);
    return [Math.min(hz[0], 0.03), Math.max(0.2, Math.min(hz.at(-1), hz[last] * 1.15))];
  }

  #splits() {
    const [low, high] = this.#range(), apart = (high - low) / Math.max(3, this.place.clientWidth / 60);
    const chosen = [];
    for (const period_s of PERIODS_S) {
      const hz = 1 / period_s;
      if (hz >= low && hz <= high && (chosen.length === 0 || hz - chosen.at(-1) > apart)) chosen.push(hz);
    }
    return chosen;
  }

  #size() { return { width: Math.max(50, this.place.clientWidth), height: Math.max(50, this.place.clientHeight) }; }
}

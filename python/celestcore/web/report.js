// Draws the panels of a report. Data: <script id="panels">, columns as base64 floats.
(function () {
  "use strict";
  // Paper has more dots than many a screen: draw with at least two pixels to the dot.
  if (devicePixelRatio < 2) Object.defineProperty(window, "devicePixelRatio", { value: 2 });

  const page = JSON.parse(document.getElementById("panels").textContent);
  const charts = [];
  const whole = page.span;
  let zoomed = false;
  let busy = false;

  function floats(text, type) {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    return Array.from(new type(bytes.buffer), (v) => (v === v ? v : null));
  }

  function plain(v, digits) {
    if (v == null) return "–";
    if (v === 0) return "0";
    const size = Math.abs(v);
    if (size >= 1e6 || size < 1e-4) return v.toExponential(Math.min(digits, 4) - 1);
    return String(Number(v.toPrecision(digits)));
  }

  function clock(x) {
    if (page.epoch == null) return "";
    const at = new Date(page.epoch + (page.start + x * page.scale) * 1000);
    return isNaN(at) ? "" : " (" + at.toISOString().slice(0, 19).replace("T", " ") + ")";
  }

  function show(min, max) {
    zoomed = min > whole[0] || max < whole[1];
    busy = true;
    for (const u of charts) u.setScale("x", { min: min, max: max });
    busy = false;
    document.body.classList.toggle("zoomed", zoomed);
  }

  function move(factor, shift) {
    const { min, max } = charts[0].scales.x;
    const half = (0.5 * (max - min)) / factor;
    fit(0.5 * (min + max) + shift * half, half);
  }

  // Show what lies around a time, without leaving the log.
  function fit(middle, half) {
    half = Math.min(half, 0.5 * (whole[1] - whole[0]));
    middle = Math.min(Math.max(middle, whole[0] + half), whole[1] - half);
    show(middle - half, middle + half);
  }

  // Behind the lines: where values are expected, gaps, thresholds, and the series' own bands.
  function shade(u, panel, halves) {
    const { left, top, width, height } = u.bbox;
    const ctx = u.ctx;
    const y = (v) => Math.min(Math.max(u.valToPos(v, "y", true), top), top + height);
    const x = (v) => Math.min(Math.max(u.valToPos(v, "x", true), left), left + width);
    ctx.save();
    for (const [low, high] of panel.bands) {
      ctx.fillStyle = "rgba(0,158,115,0.13)";
      ctx.fillRect(left, y(high), width, y(low) - y(high));
    }
    ctx.fillStyle = "rgba(120,120,120,0.28)";
    for (const [a, b] of page.gaps) {
      if (b < u.scales.x.min || a > u.scales.x.max) continue;
      ctx.fillRect(x(a), top, Math.max(x(b) - x(a), 1), height);
    }
    ctx.strokeStyle = "#6A3D9A70";
    ctx.lineWidth = devicePixelRatio;
    for (const t of page.marks) {
      if (t < u.scales.x.min || t > u.scales.x.max) continue;
      ctx.beginPath();
      ctx.moveTo(x(t), top);
      ctx.lineTo(x(t), top + height);
      ctx.stroke();
    }
    ctx.strokeStyle = "#D55E00";
    ctx.lineWidth = devicePixelRatio;
    ctx.setLineDash([5 * devicePixelRatio, 4 * devicePixelRatio]);
    for (const v of panel.lines) {
      if (v < u.scales.y.min || v > u.scales.y.max) continue;
      ctx.beginPath();
      ctx.moveTo(left, y(v));
      ctx.lineTo(left + width, y(v));
      ctx.stroke();
    }
    ctx.beginPath();
    ctx.rect(left, top, width, height);
    ctx.clip();
    halves.forEach((half, k) => {
      if (half && u.series[k].show) band(u, k, half, panel.series[k - 1].colour + "30");
    });
    ctx.restore();
  }

  // Rows on the screen, and one beyond on either side.
  function rows(u) {
    const x = u.data[0];
    const { min, max } = u.scales.x;
    let [a, b] = [0, x.length - 1];
    while (a < b && x[a + 1] < min) a++;
    while (b > a && x[b - 1] > max) b--;
    return [a, b];
  }

  function band(u, k, half, colour) {
    const [x, y] = [u.data[0], u.data[k]];
    const [a, b] = rows(u);
    const at = (i, sign) => [
      u.valToPos(x[i], "x", true),
      u.valToPos(y[i] + sign * half[i], "y", true),
    ];
    u.ctx.fillStyle = colour;
    for (let i = a; i <= b; i++) {
      if (y[i] == null || half[i] == null) continue;
      const begin = i;
      u.ctx.beginPath();
      for (; i <= b && y[i] != null && half[i] != null; i++) u.ctx.lineTo(...at(i, 1));
      for (let j = i - 1; j >= begin; j--) u.ctx.lineTo(...at(j, -1));
      u.ctx.fill();
    }
  }

  // A line that is lifted where there is no value, however short that is on the screen.
  function lifted(u, k, a, b) {
    const [x, y] = [u.data[0], u.data[k]];
    const path = new Path2D();
    let down = false;
    for (let i = a; i <= b; i++) {
      if (y[i] == null) {
        down = false;
        continue;
      }
      const at = [u.valToPos(x[i], "x", true), u.valToPos(y[i], "y", true)];
      if (down) path.lineTo(...at);
      else path.moveTo(...at);
      down = true;
    }
    return { stroke: path, fill: null, clip: null, band: null, gaps: null, flags: 1 };
  }

  // Limits of the vertical axis: those of the panel, or of what is seen once one has zoomed.
  function limits(panel, halves) {
    const decade = (v) => Math.pow(10, Math.floor(Math.log10(Math.max(v, 1e-12)) + 1e-9));
    return function (u) {
      let [low, high] = [Infinity, -Infinity];
      if (!zoomed && panel.limits) [low, high] = panel.limits;
      else {
        const [a, b] = rows(u);
        for (let k = 1; k < u.data.length; k++) {
          if (!u.series[k].show) continue;
          for (let i = a; i <= b; i++) {
            const v = u.data[k][i];
            if (v == null || (panel.log && v <= 0)) continue;
            const half = (halves[k] && halves[k][i]) || 0;
            low = Math.min(low, v - half);
            high = Math.max(high, v + half);
          }
        }
        if (low > high) [low, high] = panel.limits || [panel.log ? 1 : 0, 10];
        const margin = 0.08 * (high - low) || 0.1 * Math.abs(high) || 1;
        [low, high] = panel.log
          ? [low, high * 1.3]
          : [panel.zero ? 0 : low - margin, high + margin];
        if (panel.wrapped) {
          low = Math.max(low, panel.limits[0]);
          high = Math.min(high, panel.limits[1]);
        }
      }
      if (!panel.log) return [low, high];
      low = decade(low);
      return [low, Math.max(high, 10 * low)];
    };
  }

  function drawn(s) {
    const out = { label: s.name, stroke: s.colour, width: 1.3, points: { show: false } };
    out.paths = lifted;
    if (s.kind === "dash") {
      out.dash = [6, 4];
      out.spanGaps = true;
      delete out.paths;
    }
    if (s.kind === "steps") out.paths = uPlot.paths.stepped({ align: 1 });
    if (s.kind === "dots" || s.kind === "rings") {
      const ring = s.kind === "rings";
      out.paths = () => null;
      out.points = {
        show: true,
        size: ring ? 7 : 3,
        fill: ring ? "#fff" : s.colour,
        stroke: s.colour,
        width: ring ? 1.5 : 0,
      };
    }
    return out;
  }

  // Turn a panel into uPlot's series and columns, and half widths of bands by series.
  function columns(panel) {
    const x = floats(panel.x, Float64Array);
    const out = { series: [{ label: "t" }], data: [x], halves: [null] };
    out.series[0].value = (u, v) => (v == null ? "" : plain(v, 7) + " " + page.unit + clock(v));
    for (const s of panel.series) {
      const half = s.half && floats(s.half, Float32Array);
      const exact = s.exact && floats(s.exact, Float32Array);
      const mine = drawn(s);
      mine.value = (u, v, k, i) => {
        if (v == null || i == null) return "";
        const text = plain(exact ? exact[i] : v, 6);
        return text + (half ? " ± " + plain(half[i], 3) : "") + " " + panel.unit;
      };
      out.series.push(mine);
      out.data.push(floats(s.y, Float32Array));
      out.halves.push(half);
    }
    return out;
  }

  function axes(panel) {
    const font = "12px system-ui, sans-serif";
    const grid = { stroke: "#e3e3e3", width: 1 };
    const look = { font: font, stroke: "#333", grid: grid, ticks: { ...grid, size: 4 } };
    const time = (u, ticks) => ticks.map((v) => plain(v, 10) + " " + page.unit);
    const value = (u, ticks) => ticks.map((v) => (v == null ? "" : plain(v, 6)));
    return [
      { ...look, values: time, size: 28, space: 70 },
      { ...look, values: value, size: 62, space: 30 },
    ];
  }

  function draw(place) {
    const panel = page.panels[place.dataset.panel];
    const { series, data, halves } = columns(panel);
    const colour = (u, k) => (k ? panel.series[k - 1].colour : "transparent");
    const options = {
      width: place.clientWidth,
      height: place.clientWidth < 500 ? 210 : 240,
      series: series,
      axes: axes(panel),
      legend: { markers: { width: 2, stroke: colour, fill: colour } },
      scales: {
        x: { time: false },
        y: { distr: panel.log ? 3 : 1, range: limits(panel, halves) },
      },
      cursor: {
        y: false,
        drag: { x: true, y: false },
        sync: {
          key: "report",
          setSeries: false,
          scales: ["x", null],
          filters: { pub: (type) => type === "mousemove" || type === "mouseleave" },
        },
        bind: { dblclick: () => () => show(whole[0], whole[1]) },
      },
      hooks: {
        drawClear: [(u) => shade(u, panel, halves)],
        setScale: [
          (u, key) => {
            if (key === "x" && !busy && charts.length === page.panels.length)
              show(u.scales.x.min, u.scales.x.max);
          },
        ],
      },
    };
    const u = new uPlot(options, data, place);
    touch(u);
    charts.push(u);
    new ResizeObserver(() => {
      const width = place.clientWidth;
      if (width && width !== u.width && !matchMedia("print").matches)
        u.setSize({ width: width, height: u.height });
    }).observe(place);
  }

  // One finger along the plot reads values (up and down it scrolls the page), two fingers zoom.
  function touch(u) {
    const over = u.over;
    let start = null;
    const span = (e) => {
      const box = over.getBoundingClientRect();
      const [a, b] = [e.touches[0].clientX - box.left, e.touches[1].clientX - box.left];
      return { middle: (0.5 * (a + b)) / box.width, wide: Math.max(Math.abs(a - b), 20) / box.width };
    };
    over.addEventListener("touchstart", (e) => {
      start = null;
      if (e.touches.length !== 2) return;
      const { min, max } = u.scales.x;
      const now = span(e);
      start = { at: min + now.middle * (max - min), wide: now.wide, size: max - min };
    });
    over.addEventListener(
      "touchmove",
      (e) => {
        const box = over.getBoundingClientRect();
        if (e.touches.length === 1) {
          const at = { left: e.touches[0].clientX - box.left, top: e.touches[0].clientY - box.top };
          u.setCursor(at, true, true);
        } else if (start && e.touches.length === 2) {
          e.preventDefault();
          const now = span(e);
          const size = Math.min((start.size * start.wide) / now.wide, whole[1] - whole[0]);
          fit(start.at + (0.5 - now.middle) * size, 0.5 * size);
        }
      },
      { passive: false },
    );
  }

  function buttons() {
    const act = {
      in: () => move(2, 0),
      out: () => move(0.5, 0),
      left: () => move(1, -1),
      right: () => move(1, 1),
      all: () => show(whole[0], whole[1]),
    };
    document.querySelectorAll("[data-act]").forEach((b) => {
      b.addEventListener("click", act[b.dataset.act]);
    });
    document.querySelectorAll("[data-from]").forEach((b) => {
      const [a, z] = [Number(b.dataset.from), Number(b.dataset.to)];
      const half = Math.max(0.75 * (z - a), 0.004 * (whole[1] - whole[0]));
      b.addEventListener("click", () => {
        fit(0.5 * (a + z), half);
        if (b.dataset.goto) document.getElementById(b.dataset.goto)?.scrollIntoView();
      });
    });
  }

  // On paper plots are drawn anew at the paper's width, so that their letters keep their size.
  function paper() {
    addEventListener("beforeprint", () => {
      for (const u of charts) {
        const small = u.root.closest(".trio");
        u.setSize({ width: small ? 222 : 690, height: small ? 150 : 190 });
      }
    });
    addEventListener("afterprint", () => {
      for (const u of charts) {
        const width = u.root.parentNode.clientWidth;
        u.setSize({ width: width, height: width < 500 ? 210 : 240 });
      }
    });
  }

  document.querySelectorAll("[data-panel]").forEach(draw);
  paper();
  buttons();
  if (charts.length) show(whole[0], whole[1]);
  document.body.classList.add("drawn");
})();

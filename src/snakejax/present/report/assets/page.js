"use strict";
(() => {
  const read = (id) => JSON.parse(document.getElementById(id).textContent);
  const charts = read("charts"), movie = read("movie");
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const still = matchMedia("(prefers-reduced-motion: reduce)");
  const drawn = new Map();

  // The page's colours for what a chart does not colour itself.
  const dressed = (layout) => {
    const ink = css("--ink"), rule = css("--rule"), ground = css("--ground");
    const axis = { gridcolor: rule, zerolinecolor: rule, linecolor: rule, automargin: true };
    const made = {
      ...layout,
      font: { color: ink, family: getComputedStyle(document.body).fontFamily, size: 13 },
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      margin: { l: 60, r: 16, t: 12, b: 50 },
      legend: { orientation: "h", yanchor: "bottom", y: 1.0, x: 0, bgcolor: "rgba(0,0,0,0)" },
      hoverlabel: { bgcolor: ground, bordercolor: rule, font: { color: ink } },
      hovermode: layout.hovermode || "closest",
    };
    const names = Object.keys(layout).filter((name) => /^[xy]axis/.test(name));
    for (const name of new Set(["xaxis", "yaxis", ...names])) made[name] = { ...axis, ...layout[name] };
    made.shapes = (layout.shapes || []).map((s) => ({ ...s, line: { color: ink, ...s.line } }));
    return made;
  };

  const draw = (element) => {
    const { data, layout } = charts[element.id];
    // The buttons lie over the chart: without a mouse, which makes them come and go, they would stay there.
    const displayModeBar = matchMedia("(hover: hover) and (pointer: fine)").matches ? "hover" : false;
    const config = { responsive: true, displaylogo: false, displayModeBar,
      modeBarButtonsToRemove: ["lasso2d", "select2d"] };
    drawn.set(element.id, Plotly.newPlot(element, data, dressed(layout), config).then(() => show(element)));
  };

  // What is there by now, for who waits for it.
  const mark = (name) => { document.documentElement.dataset[name] = "yes"; performance.mark(name); };

  // What is switched on.
  const on = (name) => {
    const boxes = [...document.querySelectorAll(`.controls input[name="${name}"]`)];
    return boxes.length ? new Set(boxes.filter((b) => b.checked).map((b) => b.value)) : null;
  };
  const wanted = (meta) => ["run", "step"].every((name) => {
    const chosen = on(name);
    return !meta || meta[name] == null || chosen === null || chosen.has(meta[name]);
  });
  const show = (element) => {
    const visible = element.data.map((trace) => wanted(trace.meta));
    if (element.data.some((trace, k) => (trace.visible !== false) !== visible[k])) {
      return Plotly.restyle(element, { visible });
    }
  };
  const apply = () => {
    const back = new Set();
    for (const element of document.querySelectorAll("figure, tr[data-run]")) {
      const hidden = !wanted({ run: element.dataset.run, step: element.dataset.step });
      if (element.hidden && !hidden) back.add(element);
      element.hidden = hidden;
    }
    for (const element of document.querySelectorAll(".chart")) {
      const figure = element.closest("figure");
      if (figure.hidden || !drawn.has(element.id)) continue;
      // The window may have another width than when the chart was last seen.
      drawn.get(element.id).then(() => { if (back.has(figure)) Plotly.Plots.resize(element); return show(element); });
    }
  };
  document.querySelector(".controls")?.addEventListener("change", apply);
  apply();

  // Charts are drawn as they come near the view, so that a long page is there at once.
  const near = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      if (entry.isIntersecting && !drawn.has(entry.target.id)) draw(entry.target);
    }
  }, { rootMargin: "600px" });
  // The plotting library is unpacked while text, switches and the player are there already.
  const unpack = async () => {
    const packed = Uint8Array.from(atob(document.getElementById("plotly").textContent), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    const script = document.createElement("script");
    script.textContent = await new Response(stream).text();
    document.head.append(script);
    document.querySelectorAll(".chart").forEach((element) => near.observe(element));
    mark("charts");
  };
  setTimeout(unpack, 0);
  const redress = () => drawn.forEach((ready, id) => ready.then(() => {
    const element = document.getElementById(id);
    Plotly.relayout(element, dressed(charts[id].layout));
  }));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redress);
  addEventListener("beforeprint", () => document.querySelectorAll(".chart").forEach((e) => drawn.has(e.id) || draw(e)));

  const download = document.getElementById("download");
  download.href = URL.createObjectURL(new Blob([document.getElementById("result").textContent],
    { type: "application/json" }));

  // The moving vehicle.
  if (movie) {
    const get = (id) => document.getElementById(id), svg = get("scene"), slider = get("time");
    const make = (tag, attributes, parent) => {
      const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
      for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
      parent.append(made);
      return made;
    };
    let parts = null, playing = false, begun = 0, from = 0;
    const L = movie.length, line = { fill: "none", "vector-effect": "non-scaling-stroke" };
    const path = ({ points }) => points.map(([x, y], i) => `${i ? "L" : "M"}${x} ${y}`).join("");
    const vehicle = (colour, width, parent) => {
      const stroke = { ...line, stroke: colour, "stroke-width": width };
      const group = make("g", {}, parent);
      const outline = movie.outline.map((one) => [one, make("path", { d: path(one), ...stroke }, group)]);
      const wheels = movie.wheels.map((strokes) => {
        const wheel = make("g", {}, group);
        for (const one of strokes) make("path", { d: path(one), ...stroke, "stroke-width": 1.7 * width }, wheel);
        const skid = make("line", { x1: 0, y1: 0, x2: 0, y2: 0, ...stroke, "stroke-width": 5, opacity: 0.55,
          class: "skid" }, wheel);
        return { wheel, skid };
      });
      return { group, wheels, outline };
    };
    const at = (values, k) => Array.isArray(values) ? values[k] : values;
    const degrees = (angle) => angle * 180 / Math.PI;
    const trail = (x, y, upto) => {
      let path = "", gap = true;
      for (let k = 0; k <= upto; k++) {
        if (x[k] == null) { gap = true; continue; }
        path += `${gap ? "M" : "L"}${x[k]} ${y[k]}`;
        gap = false;
      }
      return path;
    };
    const chosen = () => {
      const run = movie.runs[get("movie-run").selectedIndex];
      return { run, model: run.models[get("movie-step").value] };
    };
    const setup = () => {
      const { run, model } = chosen();
      svg.replaceChildren();
      const xs = [...run.x, ...model.x].filter((v) => v != null), ys = [...run.y, ...model.y].filter((v) => v != null);
      const [west, east, south, north] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
      const room = 1.6 * L, foot = 34;  // pixels below, for the scale
      const [width, height] = [east - west + 2 * room, north - south + 2 * room];
      const pixel = Math.max(width / svg.clientWidth, height / (svg.clientHeight - foot)) || 1e-3;
      const low = south - room - (foot - 8) * pixel;
      svg.setAttribute("viewBox", `${west - room} ${-north - room} ${width} ${height + foot * pixel}`);
      const world = make("g", { transform: "scale(1 -1)" }, svg);
      const step = 10 ** Math.floor(Math.log10(Math.max(east - west, north - south, L))), left = west - 0.8 * room;
      make("line", { x1: left, y1: low, x2: left + step, y2: low, ...line, stroke: "currentColor", "stroke-width": 3 },
        world);
      const name = make("text", { x: left, y: -low - 6 * pixel, fill: "currentColor", "font-size": 15 * pixel }, svg);
      name.textContent = `${step} m`;
      make("path", { ...line, d: trail(run.x, run.y, run.t.length - 1), stroke: movie.measured, "stroke-width": 4,
        opacity: 0.25 }, world);
      parts = {
        seen: make("path", { ...line, stroke: movie.measured, "stroke-width": 2, opacity: 0.6 }, world),
        path: make("path", { ...line, stroke: model.colour, "stroke-width": 1.5 }, world),
        ghost: vehicle(movie.measured, 3, world),
        vehicle: vehicle(model.colour, 1.6, world),
      };
      parts.ghost.group.setAttribute("opacity", 0.6);
      slider.max = run.t[run.t.length - 1];
      place();
    };
    const put = (drawn, pose, model, k, skids) => {
      const x = pose.x[k];
      drawn.group.style.display = x == null ? "none" : "";
      if (x == null) return;
      drawn.group.setAttribute("transform", `translate(${x} ${pose.y[k]}) rotate(${degrees(pose.heading[k])})`);
      for (const [{ part, pivot }, drawnPath] of drawn.outline) {
        const angle = part === "base" ? 0 : at(model.joints[part], k);
        drawnPath.setAttribute("transform", `translate(${pivot[0]} ${pivot[1]}) rotate(${degrees(angle)})`);
      }
      drawn.wheels.forEach(({ wheel, skid }, i) => {
        const { x, y, angle } = model.wheels[i];
        wheel.setAttribute("transform", `translate(${at(x, k)} ${at(y, k)}) rotate(${degrees(at(angle, k))})`);
        skid.setAttribute("y2", skids ? model.slip[i][k] * movie.skid : 0);
      });
    };
    const place = () => {
      const { run, model } = chosen(), now = Number(slider.value);
      let k = run.t.findIndex((t) => t >= now - 1e-9);
      if (k < 0) k = run.t.length - 1;
      put(parts.ghost, run, model, k, false);
      put(parts.vehicle, model, model, k, true);
      parts.seen.setAttribute("d", trail(run.x, run.y, k));
      parts.path.setAttribute("d", trail(model.x, model.y, k));
      const apart = run.x[k] == null ? "frame lost" :
        `${(1000 * Math.hypot(run.x[k] - model.x[k], run.y[k] - model.y[k])).toFixed(1)} mm and ` +
        `${degrees(run.heading[k] - model.heading[k]).toFixed(2)} degrees apart`;
      const text = `${run.t[k].toFixed(2)} s, ${apart}`;
      get("now").textContent = text;
      slider.setAttribute("aria-valuetext", text);
    };
    const tick = (now) => {
      if (!playing) return;
      const end = Number(slider.max);
      const time = from + (now - begun) / 1000 * Number(get("movie-speed").value);
      slider.value = Math.min(time, end);
      place();
      if (time >= end) return stop();
      requestAnimationFrame(tick);
    };
    const stop = () => { playing = false; get("play").textContent = "Play"; get("play").setAttribute("aria-pressed", false); };
    const start = () => {
      playing = true;
      from = Number(slider.value) >= Number(slider.max) ? 0 : Number(slider.value);
      begun = performance.now();
      get("play").textContent = "Pause";
      get("play").setAttribute("aria-pressed", true);
      requestAnimationFrame(tick);
    };
    get("play").addEventListener("click", () => (playing ? stop() : start()));
    get("movie-speed").addEventListener("change", () => { from = Number(slider.value); begun = performance.now(); });
    slider.addEventListener("input", () => { stop(); place(); });
    for (const id of ["movie-run", "movie-step"]) get(id).addEventListener("change", () => { stop(); slider.value = 0; setup(); });
    setup();
    addEventListener("resize", setup);
    if (still.matches) slider.value = slider.max, place();
  }
  mark("ready");
})();

/** The explorer: sliders, handles and the map of the self-motion, beside the picture of the replay page. */
"use strict";
function explore({ scene, THREE, viewer, put, Tube, legend, poses, show, turned, size, about }) {
  const data = scene.explorer, robot = new Kinematics.Robot(data), posture = new Kinematics.Posture(robot, data.q, data.V);
  const start = posture.z, names = { m: "m", rad: "rad" }, V3 = THREE.Vector3, round = x => Math.abs(x) < 5e-4 ? 0 : x;

  // -- what stands beside the picture ------------------------------------------------------------------------------------
  const style = document.createElement("style");
  style.textContent = `
    body.explorer #view { right: 330px; bottom: 0; touch-action: none; }
    body.explorer #bar { display: none; }
    body.explorer #about { max-width: min(34em, calc(100vw - 370px)); }
    /* Nothing may stand between the mouse and the handles. */
    body.explorer #legend { position: fixed; left: 20px; bottom: 14px; }
    body.explorer #legend button { pointer-events: none; }
    #panel { position: absolute; right: 0; top: 0; bottom: 0; width: 330px; overflow-y: auto; padding: 14px 16px 20px;
      background: rgba(255, 255, 255, .94); border-left: 1px solid var(--line); }
    #panel h2 { font-size: 14px; margin: 14px 0 4px; }
    #panel h2 select { min-height: 28px; padding: 0 4px; }
    #panel h2:first-child { margin-top: 0; }
    #panel .row { display: grid; grid-template-columns: 2.6em minmax(4em, 1fr) minmax(5.6em, max-content); align-items: center; gap: 8px; min-height: 26px; }
    #panel input[type=range] { width: 100%; height: 24px; margin: 0; accent-color: var(--accent); cursor: pointer; }
    #panel output, #panel td:last-child { font-variant-numeric: tabular-nums; text-align: right; white-space: nowrap; }
    #panel table { width: 100%; border-collapse: collapse; }
    #panel td { padding: 1px 0; vertical-align: top; }
    #panel td:first-child { color: var(--soft); }
    #panel .joint { display: grid; grid-template-columns: 1fr 7.5em 4.6em; gap: 8px; align-items: center; font-size: 12px; min-height: 20px; }
    #panel .joint span:first-child { overflow: hidden; text-overflow: ellipsis; white-space: nowrap; }
    #panel .range { position: relative; height: 8px; border: 1px solid var(--soft); border-radius: 4px; }
    #panel .range i { position: absolute; top: -3px; width: 4px; height: 12px; margin-left: -2px; background: var(--ink); border-radius: 2px; }
    #panel .beyond { font-weight: 700; }
    #panel .beyond .range { border-style: dashed; border-width: 2px; }
    #map { width: 100%; height: 132px; display: block; border: 1px solid var(--line); border-radius: 6px; cursor: crosshair; touch-action: none; }
    #panel .scale { display: flex; align-items: center; gap: 8px; font-size: 12px; font-variant-numeric: tabular-nums; margin: 4px 0 0; }
    #panel .scale i { flex: 1; height: 10px; border: 1px solid var(--line); border-radius: 3px; }
    #panel .key { display: flex; flex-wrap: wrap; gap: 2px 12px; font-size: 12px; color: var(--soft); margin: 4px 0 0; }
    #panel .key canvas { width: 22px; height: 12px; vertical-align: -1px; margin-right: 4px; border: 1px solid var(--line); }
    #panel button, #panel select { font: inherit; color: inherit; background: #fff; border: 1px solid var(--line); border-radius: 8px; min-height: 34px;
      padding: 2px 10px; cursor: pointer; }
    #panel .buttons { display: flex; flex-wrap: wrap; gap: 8px; margin-top: 8px; }
    #said { min-height: 1.4em; margin: 6px 0 0; color: #9a3412; font-weight: 600; }
    @media (max-width: 720px) {
      body.explorer #view { right: 0; bottom: 52vh; }
      body.explorer #about { max-width: calc(100vw - 40px); }
      body.explorer #caption, body.explorer #scale { display: none; }
      body.explorer #legend { bottom: calc(52vh + 6px); font-size: 12px; }
      #panel { left: 0; width: auto; top: 48vh; border-left: 0; border-top: 1px solid var(--line); }
    }`;
  document.head.append(style);
  document.body.classList.add("explorer");
  const panel = document.createElement("div");
  panel.id = "panel";
  about.after(panel);
  const add = (tag, text = "", parent = panel, name = "") => {
    const made = document.createElement(tag);
    made.textContent = text;
    if (name) made.className = name;
    parent.append(made);
    return made;
  };

  /** A slider with its name and value; `moved` takes the value asked for. */
  function slider(name, title, reach, unit, moved) {
    const row = add("label", "", panel, "row"), input = document.createElement("input");
    add("span", name, row);
    Object.assign(input, { type: "range", min: -reach, max: reach, step: .001, value: 0, title });
    input.setAttribute("aria-label", title);
    row.append(input);
    const output = add("output", "", row);
    input.oninput = () => moved(Number(input.value));
    return value => { input.value = value; output.textContent = `${round(value).toFixed(3)} ${unit}`; };
  }
  add("h2", `Self-motion v (${robot.r})`);
  const ownSliders = Array.from({ length: robot.r }, (_, k) => slider(robot.r === 1 ? "v" : `v${k + 1}`, `Self-motion coordinate ${k + 1}`,
    robot.r === 1 ? 8 : 3, data.unit, value => {
      const v = Float64Array.from(posture.v);
      v[k] = value;
      go(posture.z, v);
    }));
  const said = add("p");
  said.id = "said";
  said.setAttribute("role", "status");

  const map = document.createElement("canvas"), chosen = [], loopy = robot.r === 1, head = add("h2", loopy ? "Its loop, by " : "Map of ");
  const choose = (label, options, first, changed) => {
    const made = add("select", "", head);
    made.setAttribute("aria-label", label);
    for (const [name, text] of options) add("option", text, made).value = name;
    made.value = first;
    made.onchange = changed;
    return made;
  };
  if (!loopy) for (const k of [0, 1]) {
    if (k) head.append(" and ");
    chosen.push(choose(k ? "Upward coordinate of the map" : "Rightward coordinate of the map", Array.from({ length: robot.r }, (_, i) => [i, `v${i + 1}`]), k, look));
  }
  if (!loopy) head.append(", by ");
  const by = choose(loopy ? "Quantity along the loop, as height and colour" : "Quantity as colour", [...data.weighs ? [["energy", "potential energy"], ["torque", "gravity torque"], ["coupling", "inertial coupling"]] : [], ["manipulability", "manipulability"],
    ["margin", "margin of the chart"], ...data.capsules.pairs.length ? [["apart", "distance of links"]] : []], data.weighs ? "energy" : "manipulability", () => { if (loopy) { paint(); drawMap(); show(); } else drawSurvey(); });
  map.id = "map";
  map.setAttribute("role", "img");
  map.setAttribute("aria-label", loopy ? "Postures at this task point, along the curve of the self-motion" : "Postures at this task point, over two coordinates of v");
  panel.append(map);
  // The colours from the least value to the greatest, from dark to bright; along a loop it is read from the height, too.
  const ramp = `linear-gradient(to right, ${data.colours.join(", ")})`, ends = [], scale = add("div", "", panel, "scale");
  ends.push(add("span", "", scale));
  add("i", "", scale).style.background = ramp;
  ends.push(add("span", "", scale));
  const key = add("p", "", panel, "key");
  for (const [kind, text] of [["limit", "beyond a joint limit"], ["touch", "links touch"], ["singular", "near singular"], ...loopy ? [] : [["edge", "beyond the chart"]]]) {
    const item = add("span", "", key), swatch = document.createElement("canvas");
    Object.assign(swatch, { width: 44, height: 24 });
    const context = swatch.getContext("2d");
    context.fillStyle = pattern(context, kind);
    context.fillRect(0, 0, 44, 24);
    item.append(swatch, text);
  }
  if (loopy && data.weighs) { add("span", "● at rest, stable", key); add("span", "○ at rest, unstable", key); }
  const buttons = add("div", "", panel, "buttons");
  add("button", "Start posture", buttons).onclick = () => jump(data.q);
  if (data.components.length) {
    const others = add("select", "", buttons);
    others.setAttribute("aria-label", "Component of the self-motion manifold at the start");
    [data.q, ...data.components].forEach((_, k) => { add("option", k ? `component ${k + 1}` : "component 1, the start", others).value = k; });
    others.onchange = () => jump([data.q, ...data.components][Number(others.value)]);
  }
  add("h2", `Task z (${robot.m})`);
  const taskSliders = data.labels.map((label, i) => slider(label, `Task coordinate ${label}, from the start`,
    data.units[i] === "m" ? .6 * data.reach : 3, names[data.units[i]] ?? data.units[i], value => {
      const delta = robot.minus(posture.z, start);
      delta[i] = value;
      go(robot.plus(start, delta), posture.v);
    }));
  add("h2", "Now");
  const table = add("table"), cells = {};
  for (const [id, text] of [["error", "task error"], ["margin", "margin of the chart"], ["charts", "charts used"], ["manipulability", "manipulability"],
    ...data.capsules.pairs.length ? [["apart", "links apart"]] : [], ...data.weighs ? [["torque", "largest gravity torque"], ["energy", "potential energy"], ["coupling", "inertial coupling"]] : [], ["pace", "computing, pictures"]]) {
    const row = add("tr", "", table);
    add("td", text, row);
    cells[id] = add("td", "", row);
  }
  add("h2", "Joints within their limits");
  const bars = data.joints.map((name, i) => {
    const row = add("div", "", panel, "joint");
    add("span", name, row).title = name;
    const range = add("div", "", row, "range"), mark = add("i", "", range), value = add("span", "", row);
    value.style.textAlign = "right";
    if (data.lower[i] === null && data.upper[i] === null) range.style.visibility = "hidden";
    return { row, mark, value };
  });

  // -- handles and the loop in the picture -------------------------------------------------------------------------------
  const knob = (geometry, color) => {
    const mesh = new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({ color: new THREE.Color(color).convertSRGBToLinear(), depthTest: false, transparent: true, opacity: .88 }));
    mesh.renderOrder = 5;
    return mesh;
  };
  const handles = [], moved = (part, values) => { const z = Array.from(posture.z); z.splice(part.at, values.length, ...values); go(z, posture.v); };
  for (const part of robot.parts) if (part.kind === 0 || part.kind === 2)
    handles.push({ name: "● hand: drag to move the task", color: "#d55e00", joint: part.joint, local: part.tip,
      mesh: knob(new THREE.SphereGeometry(.018 * size, 24, 16), "#d55e00"), drag: p => moved(part, part.kind === 2 ? p : part.axes.map(axis => p[axis])) });
  handles.push({ name: `◆ ${data.elbow.name}: drag to move v`, color: "#0072b2", joint: data.elbow.joint, local: data.elbow.place,
    mesh: knob(new THREE.OctahedronGeometry(.024 * size), "#0072b2"), drag: p => { posture.pull(data.elbow.joint, data.elbow.place, p); say(""); update(); } });
  for (const part of robot.parts) if (part.kind === 4) {
    // A point ahead on the axis.
    const far = .12 * size, local = part.tip.map((x, i) => i < 9 ? x : x + far * part.tip[3 * (i - 9) + 2]);
    handles.push({ name: "■ axis: drag to tilt it", color: "#e69f00", joint: part.joint, local, mesh: knob(new THREE.BoxGeometry(.026 * size, .026 * size, .026 * size), "#e69f00"),
      drag: p => {
        robot.place(posture.q);
        const from = robot.carried(part.joint, part.tip).subarray(9), way = p.map((x, i) => x - from[i]), length = Math.hypot(...way);
        if (length > 0) moved(part, way.map(x => x / length));
      } });
  }
  for (const { name, color, mesh } of handles) { put(["Handles", name], mesh); legend(name, color, 12, mesh); }
  const loop = new THREE.Group(), ribbons = [];
  put(["Loop"], loop);
  if (loopy) { legend(`loop of the ${data.elbow.name}; thin: barred`, ramp, 5, loop); }

  const say = text => { said.textContent = text; };
  function go(z, v) {
    const began = performance.now();
    const reached = posture.moveTo(z, v);
    say(reached < 1 ? "The robot cannot go further this way." : "");
    update(began);
  }
  function jump(q) {
    say("");
    posture.jump(q);
    update();
  }

  const matrix = new THREE.Matrix4(), quaternion = new THREE.Quaternion(), where = new Float64Array(robot.n * 12);
  let traced = null, drawnFor = null, pictured = 0;
  const state = window.explorer = { robot, posture, go, jump, handles, milliseconds: 0, rate: 0, loop: () => traced, map: () => surveyed, idle: () => Boolean(traced || surveyed) && !looking };

  /** Bring the picture and the numbers up to where the posture is. */
  function update(began = performance.now()) {
    const error = posture.error();
    where.set(robot.place(posture.q));
    for (let i = 0; i < robot.n; i++) {
      const w = 12 * i, T = data.turns[i], R = [0, 0, 0, 0, 0, 0, 0, 0, 0];
      for (let a = 0; a < 3; a++) for (let b = 0; b < 3; b++) for (let k = 0; k < 3; k++) R[3 * a + b] += where[w + 3 * a + k] * T[3 * b + k];
      matrix.set(R[0], R[1], R[2], 0, R[3], R[4], R[5], 0, R[6], R[7], R[8], 0, 0, 0, 0, 1);
      quaternion.setFromRotationMatrix(matrix);
      poses.set([where[w + 9], where[w + 10], where[w + 11], quaternion.x, quaternion.y, quaternion.z, quaternion.w], 7 * i);
    }
    for (const handle of handles) { handle.at = Array.from(robot.carried(handle.joint, handle.local).subarray(9)); handle.mesh.position.set(...handle.at); }
    const { energy, torque } = robot.gravityLoad(), apart = robot.clearance(), { value, ratio } = robot.manipulability(posture.J);
    robot.minus(posture.z, start).forEach((x, i) => taskSliders[i](x));
    posture.v.forEach((x, k) => ownSliders[k](x));
    cells.error.textContent = error.toExponential(1);
    cells.margin.textContent = posture.margin.toFixed(3);
    cells.charts.textContent = posture.charts;
    cells.manipulability.textContent = `${value.toPrecision(3)}${ratio < .03 ? ", near singular" : ""}`;
    if (cells.apart) cells.apart.textContent = apart < 0 ? "they touch" : `${(1000 * apart).toFixed(0)} mm`;
    if (cells.torque) {
      const { worst } = load(torque);
      cells.torque.textContent = `${Math.abs(torque[worst]).toFixed(1)}${data.effort[worst] ? ` of ${data.effort[worst].toFixed(0)}` : ""} ${robot.prismatic[worst] ? "N" : "N m"}`;
      cells.energy.textContent = `${energy.toFixed(2)} J`;
      cells.coupling.textContent = robot.coupling(posture.J).toFixed(3);
    }
    bars.forEach(({ row, mark, value: text }, i) => {
      const low = data.lower[i], high = data.upper[i], x = posture.q[i], off = beyond(posture.q, i);
      row.classList.toggle("beyond", off);
      text.textContent = `${x.toFixed(3)}${off ? " !" : ""}`;
      row.title = off ? "beyond its limit" : "";
      if (low !== null && high !== null) mark.style.left = `${Math.min(Math.max(100 * (x - low) / (high - low), 0), 100)}%`;
    });
    show();
    if (!loopy) { drawSurvey(); look(); }
    else if (!drawnFor || Math.max(...robot.minus(posture.z, drawnFor).map(Math.abs)) > 1e-9 || nearest() === null) look();
    else drawMap();
    state.milliseconds = performance.now() - began;
    // Pictures are counted while something moves, and a pause is not a slow picture.
    requestAnimationFrame(now => {
      if (now > pictured && now - pictured < 500) state.rate += .2 * (1000 / (now - pictured) - state.rate);
      pictured = now;
      cells.pace.textContent = `${state.milliseconds.toFixed(1)} ms, ${state.rate.toFixed(0)} / s`;
    });
  }
  /** Joint whose gravity torque is the largest part of its limit, and that part; where limits are missing, the torque itself. */
  const load = torque => {
    const used = Array.from(torque, (t, i) => Math.abs(t) / (data.effort.every(Boolean) ? data.effort[i] : 1)), most = Math.max(...used);
    return { worst: used.indexOf(most), used: most };
  };
  const beyond = (q, i) => data.lower[i] !== null && q[i] < data.lower[i] - 1e-9 || data.upper[i] !== null && q[i] > data.upper[i] + 1e-9;

  const kindOf = (q, apart, ratio) => q.some((_, i) => beyond(q, i)) ? "limit" : apart < 0 ? "touch" : ratio < .03 ? "singular" : "";

  // -- work that is spread over pictures, lest one of them be late ---------------------------------------------------------
  /** Time for it in each picture [ms]. */
  const SLICE = 3;
  /** Yielded where what follows takes as long as a slice, so that it begins with the next picture. */
  const NEXT_PICTURE = Symbol("next picture");
  let looking = null, stale = false;
  /** Look around the posture; while that is going on, once more when it is done. */
  function look() {
    stale = true;
    if (looking) return;
    looking = views();
    const work = () => {
      // The first time nothing moves yet.
      const end = traced || surveyed ? performance.now() + SLICE : Infinity;
      while (looking && performance.now() < end) {
        const { done, value } = looking.next();
        if (done) looking = null;
        if (value === NEXT_PICTURE) break;
      }
      if (looking) requestAnimationFrame(work);
    };
    requestAnimationFrame(work);
  }
  function* views() { while (stale) { stale = false; yield* loopy ? retrace() : survey(); } }

  /** Kind of a posture, and the quantities that are shown as colour, after `place`. */
  function measured(q, J, chart) {
    const { value, ratio } = robot.manipulability(J), { energy, torque } = robot.gravityLoad(), apart = robot.clearance();
    const coupling = data.weighs ? robot.coupling(J) : 0;
    return { kind: kindOf(q, apart, ratio), measures: { energy, torque: load(torque).used, manipulability: value, margin: chart.margin(J), apart, coupling } };
  }

  // -- the loop ----------------------------------------------------------------------------------------------------------
  function* retrace() {
    const { z, chart } = posture, found = yield* Kinematics.trace(robot, posture.q, z);
    Object.assign(found, { kinds: [], heights: [], places: [] });
    for (const q of found.nodes) {
      const { kind, measures } = measured(q, robot.evaluate(q).J, chart);
      found.kinds.push(kind);
      found.heights.push(measures);
      found.places.push(Array.from(robot.carried(data.elbow.joint, data.elbow.place).subarray(9)));
      yield;
    }
    yield NEXT_PICTURE;
    traced = found;
    drawnFor = z;
    for (const mesh of loop.children) { mesh.geometry.dispose(); mesh.material.dispose(); }
    loop.clear();
    ribbons.length = 0;
    for (let i = 0; i + 1 < traced.nodes.length;) {
      let j = i + 1;
      const good = !traced.kinds[i];
      while (j + 1 < traced.nodes.length && !traced.kinds[j] === good) j++;
      const tube = new Tube((good ? .005 : .0016) * size, "#ffffff", .99);
      for (let k = i; k <= j; k++) tube.push(new V3(...traced.places[k]));
      tube.show(Infinity);
      tube.mesh.material.vertexColors = true;
      loop.add(tube.mesh);
      ribbons.push({ tube, from: i });
      i = j;
    }
    paint();
    drawMap();
    show();
  }
  /** Chosen quantity at each posture, its least and its greatest value, and whether it is level but for rounding. */
  function quantity(all) {
    const heights = all.map(each => each[by.value]), least = Math.min(...heights), most = Math.max(...heights);
    const unit = { energy: " J", torque: data.effort.every(Boolean) ? " of the limit" : robot.prismatic.some(Boolean) ? " N m or N" : " N m", apart: " m" }[by.value] ?? "";
    ends.forEach((end, k) => { const value = [least, most][k]; end.textContent = `${Math.abs(value) < 1e-9 ? 0 : Number(value.toPrecision(3))}${unit}`; });
    return { heights, least, most, level: most - least < 1e-6 * Math.max(1, Math.abs(most)) };
  }
  /** Colour of a part of the way from the least value to the greatest. */
  function shaded(part) {
    const last = shades.length - 1, x = last * part, low = Math.min(Math.floor(x), last - 1);
    return shade.lerpColors(shades[low], shades[low + 1], x - low);
  }
  const shades = data.colours.map(colour => new THREE.Color(colour).convertSRGBToLinear()), shade = new THREE.Color();
  /** Colour the loop in the picture by the chosen quantity. */
  function paint() {
    if (!traced) return;
    const { heights, least, most, level } = quantity(traced.heights);
    for (const { tube: { mesh, count, points, room }, from } of ribbons) {
      const around = points.length / (3 * room), colours = new Float32Array(points.length);
      for (let k = 0; k < count; k++) {
        shaded(level ? 0 : (heights[from + k] - least) / (most - least));
        for (let side = 0; side < around; side++) shade.toArray(colours, 3 * (around * k + side));
      }
      mesh.geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3));
    }
  }
  /** Number of the node next to the posture, whole turns left aside; null where it is on another curve. */
  function nearest() {
    let best = Infinity, found = 0;
    traced?.nodes.forEach((q, k) => {
      let apart = 0;
      for (let i = 0; i < robot.n; i++) { const d = posture.q[i] - q[i]; apart += (robot.prismatic[i] ? d : d - 2 * Math.PI * Math.round(d / (2 * Math.PI))) ** 2; }
      if (apart < best) { best = apart; found = k; }
    });
    return best < .04 ? found : null;
  }
  /** Stripes, a grid or dots, so that kinds are told apart without colours. */
  function pattern(context, kind) {
    const tile = document.createElement("canvas");
    tile.width = tile.height = 12;
    const draw = tile.getContext("2d");
    Object.assign(draw, { strokeStyle: "#7b8794", fillStyle: "#7b8794", lineWidth: 1.6 });
    draw.beginPath();
    if (kind === "limit" || kind === "touch") for (const k of [-12, 0, 12]) { draw.moveTo(k - 2, 14); draw.lineTo(k + 14, -2); }
    if (kind === "touch") for (const k of [-12, 0, 12]) { draw.moveTo(k - 2, -2); draw.lineTo(k + 14, 14); }
    draw.stroke();
    if (kind === "edge") draw.fillRect(0, 0, 12, 12);
    if (kind === "singular") for (const [x, y] of [[3, 3], [9, 9]]) { draw.beginPath(); draw.arc(x, y, 1.8, 0, 7); draw.fill(); }
    return context.createPattern(tile, "repeat");
  }
  /** A clean sheet for the map. */
  function sheet() {
    const scale = devicePixelRatio || 1, wide = map.clientWidth, tall = map.clientHeight, context = map.getContext("2d");
    if (map.width !== Math.round(wide * scale)) { map.width = Math.round(wide * scale); map.height = Math.round(tall * scale); }
    context.setTransform(scale, 0, 0, scale, 0, 0);
    context.clearRect(0, 0, wide, tall);
    return { context, wide, tall };
  }
  function drawMap() {
    if (!traced || !map.clientWidth) return;
    const { context, wide, tall } = sheet(), { s, kinds, closed } = traced, length = s[s.length - 1] || 1, { heights, least, most, level } = quantity(traced.heights), span = level ? 1 : most - least;
    const x = k => 8 + (wide - 16) * s[k] / length, y = k => tall - 14 - (tall - 28) * (heights[k] - least) / span;
    for (let k = 0; k + 1 < s.length; k++) if (kinds[k]) {
      context.fillStyle = patterns[kinds[k]] ??= pattern(context, kinds[k]);
      context.fillRect(x(k), 0, x(k + 1) - x(k) + .6, tall);
    }
    Object.assign(context, { strokeStyle: "#0072b2", lineWidth: 2.4 });
    context.beginPath();
    s.forEach((_, k) => context.lineTo(x(k), y(k)));
    context.stroke();
    if (by.value === "energy") for (let k = closed ? 0 : 1; k + 1 < s.length; k++) {
      const before = heights[k ? k - 1 : s.length - 2], after = heights[k + 1], sense = Math.sign(heights[k] - before);
      if (!sense || sense !== Math.sign(heights[k] - after) || level) continue;
      context.beginPath();
      context.arc(x(k), y(k), 5, 0, 7);
      context.fillStyle = sense < 0 ? "#0072b2" : "#fff";
      context.fill();
      context.stroke();
    }
    const at = nearest();
    if (at === null) return;
    Object.assign(context, { strokeStyle: "#1d2733", lineWidth: 1.5, fillStyle: "#d55e00" });
    context.beginPath();
    context.moveTo(x(at), 0);
    context.lineTo(x(at), tall);
    context.stroke();
    context.fillRect(x(at) - 5, y(at) - 5, 10, 10);
    context.strokeRect(x(at) - 5, y(at) - 5, 10, 10);
  }
  const patterns = {};

  // -- two coordinates of v ----------------------------------------------------------------------------------------------
  /** Half of the map's width and height in v, and cells from its middle to its edge. */
  const SPAN = 1.5, CELLS = 8;
  let surveyed = null;
  /** Kinds of posture over two coordinates of v, on the chart that the posture is on; from the middle outwards. */
  function* survey() {
    const [i, j] = chosen.map(each => Number(each.value)), { chart, z, u } = posture, v = Float64Array.from(posture.v), side = 2 * CELLS + 1;
    const kinds = new Array(side * side).fill("edge"), heights = new Array(side * side), known = new Map();
    const order = Array.from({ length: side * side }, (_, c) => [c % side - CELLS, Math.floor(c / side) - CELLS]).sort(([a, b], [c, d]) => a * a + b * b - c * c - d * d);
    for (const [a, b] of i === j ? [] : order) {
      yield;
      const from = a || b ? known.get(`${a - Math.sign(a) * (Math.abs(a) >= Math.abs(b))},${b - Math.sign(b) * (Math.abs(b) >= Math.abs(a))}`) : u;
      if (!from) continue;
      const target = Float64Array.from(v);
      target[i] += SPAN * a / CELLS;
      target[j] += SPAN * b / CELLS;
      const found = chart.inverse(z, target, from);
      if (!found || chart.margin(found.J) < .3) continue;
      known.set(`${a},${b}`, found.u);
      robot.place(found.q);
      const { kind, measures } = measured(found.q, found.J, chart), cell = (b + CELLS) * side + a + CELLS;
      kinds[cell] = kind;
      heights[cell] = measures;
    }
    yield NEXT_PICTURE;
    surveyed = { i, j, chart, z, v, kinds, heights };
    drawSurvey();
  }
  /** Colours of the cells by the chosen quantity, found once for each. */
  function cellColours() {
    const { heights } = surveyed, known = heights.filter(Boolean);
    if (surveyed.by === by.value || !known.length) return surveyed.colours ?? [];
    const { least, most, level } = quantity(known), part = cell => level ? 0 : (cell[by.value] - least) / (most - least);
    const colours = heights.map(cell => cell && `#${shaded(part(cell)).clone().convertLinearToSRGB().getHexString()}`);
    return Object.assign(surveyed, { by: by.value, colours }).colours;
  }
  function drawSurvey() {
    if (!surveyed || !map.clientWidth) return;
    const { context, wide, tall } = sheet(), { i, j, v, kinds, chart } = surveyed, side = 2 * CELLS + 1, colours = cellColours();
    kinds.forEach((kind, c) => {
      const box = [wide * (c % side) / side, tall * (1 - (Math.floor(c / side) + 1) / side), wide / side + .6, tall / side + .6];
      if (colours[c]) {
        context.fillStyle = colours[c];
        context.fillRect(...box);
      }
      if (!kind) return;
      context.fillStyle = patterns[kind] ??= pattern(context, kind);
      context.fillRect(...box);
    });
    const x = wide * (.5 + (posture.v[i] - v[i]) / SPAN * CELLS / side), y = tall * (.5 - (posture.v[j] - v[j]) / SPAN * CELLS / side);
    if (chart !== posture.chart) return;
    Object.assign(context, { strokeStyle: "#1d2733", lineWidth: 1.5, fillStyle: "#d55e00" });
    context.fillRect(x - 5, y - 5, 10, 10);
    context.strokeRect(x - 5, y - 5, 10, 10);
  }
  {
    let goal = null;
    /** Go along the loop to a part of its length. */
    const alongLoop = right => {
      const began = performance.now(), from = nearest();
      goal = null;
      if (!traced || from === null) return;
      const length = traced.s[traced.s.length - 1], z = posture.z, to = traced.s.findIndex(s => s >= length * right - 1e-9);
      for (let k = from; k !== to;) {
        if (performance.now() > began + SLICE) { goal = right; break; }
        k += Math.sign(to - k);
        // The same turn of the joints as now.
        const node = traced.nodes[k].map((value, i) => robot.prismatic[i] ? value : value + 2 * Math.PI * Math.round((posture.q[i] - value) / (2 * Math.PI)));
        if (posture.moveTo(z, posture.chart.at(node)) < 1) break;
      }
      update(began);
      if (goal !== null) requestAnimationFrame(() => { if (goal === right) alongLoop(right); });
    };
    let sheetHeld = null;
    const follow = event => {
      const box = map.getBoundingClientRect(), inside = x => Math.min(Math.max(x, 0), 1);
      if (loopy) return alongLoop(inside((event.clientX - box.left - 8) / (box.width - 16)));
      const { i, j, v } = sheetHeld, target = Float64Array.from(posture.v), side = (2 * CELLS + 1) / CELLS;
      target[i] = v[i] + SPAN * side * (inside((event.clientX - box.left) / box.width) - .5);
      target[j] = v[j] - SPAN * side * (inside((event.clientY - box.top) / box.height) - .5);
      if (i !== j) go(posture.z, target);
    };
    map.onpointerdown = event => {
      map.setPointerCapture(event.pointerId);
      // What is under the finger stays there until it is lifted.
      sheetHeld = surveyed;
      follow(event);
    };
    map.onpointermove = event => { if (event.buttons && (loopy || sheetHeld)) follow(event); };
  }

  // -- dragging ----------------------------------------------------------------------------------------------------------
  const view = document.getElementById("view"), ray = new THREE.Raycaster();
  let held = null;
  const onScreen = at => {
    const box = view.getBoundingClientRect(), p = turned(new V3(...at)).project(viewer.camera);
    return [box.left + (.5 + .5 * p.x) * box.width, box.top + (.5 - .5 * p.y) * box.height];
  };
  state.onScreen = onScreen;
  const under = event => {
    const point = event.touches ? event.touches[0] : event, reach = event.pointerType === "touch" || event.touches ? 42 : 26;
    const near = handles.filter(handle => handle.mesh.visible).map(handle => ({ handle, apart: Math.hypot(onScreen(handle.at)[0] - point.clientX, onScreen(handle.at)[1] - point.clientY) }));
    return near.filter(({ apart }) => apart < reach).sort((a, b) => a.apart - b.apart)[0]?.handle ?? null;
  };
  for (const kind of ["pointerdown", "mousedown", "touchstart"]) view.addEventListener(kind, event => {
    const found = held || under(event);
    if (!found) return;
    // The camera stays where it is.
    event.stopPropagation();
    event.preventDefault();
    held = found;
    viewer.controls.enabled = false;
  }, { capture: true, passive: false });
  addEventListener("pointermove", event => {
    if (!held) { view.style.cursor = event.target.closest?.("#view") && under(event) ? "grab" : ""; return; }
    const box = view.getBoundingClientRect(), camera = viewer.camera, middle = turned(new V3(...held.at));
    ray.setFromCamera({ x: 2 * (event.clientX - box.left) / box.width - 1, y: 1 - 2 * (event.clientY - box.top) / box.height }, camera);
    const plane = new THREE.Plane().setFromNormalAndCoplanarPoint(camera.getWorldDirection(new V3()), middle), hit = ray.ray.intersectPlane(plane, new V3());
    if (hit) held.drag([hit.x, -hit.z, hit.y]);
  });
  for (const kind of ["pointerup", "pointercancel"]) addEventListener(kind, () => {
    held = null;
    viewer.controls.enabled = true;
  });
  addEventListener("resize", () => { if (loopy) drawMap(); else drawSurvey(); });
  update();
}

// Shadows of meshes from all sides where something stands elsewhere than in the scene: rays from nodes, as in
// irodori/rendering/interactive/mesh_shadows.py, on grids of half as many nodes a side and with fewer rays.
"use strict";
var Irodori = Irodori || {};

(function () {
  const SIDE = 64,
    EQUATOR = 64,
    RISE = 1 / 262144,
    INSET = 0.05,
    LIFT = 1e-3,
    ENCLOSED = 0.9,
    FOOT = 0.1,
    LEAST = 0.02;
  const PASSES = [16, 128],
    SLICE_MS = 12;
  const LEFT = 0,
    UNCOVERED = 1,
    HIDDEN = 2,
    LAYERS = 3;
  const add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]],
    subtract = (a, b) => add(a, b, -1);
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2],
    scaled = (a, s) => [s * a[0], s * a[1], s * a[2]];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a, other) => {
    const l = Math.hypot(...a);
    return l > 1e-6 ? scaled(a, 1 / l) : other;
  };
  const times = (m, v) => m.map((row) => dot(row, v)),
    back = (m, v) => [0, 1, 2].map((c) => m[0][c] * v[0] + m[1][c] * v[1] + m[2][c] * v[2]);
  const warped = (x) => (Math.abs(x) <= 1 ? 0.5 * x : Math.sign(x) * (1 - 0.5 / Math.abs(x)));
  const unwarped = (x) => (Math.abs(x) <= 0.5 ? 2 * x : (Math.sign(x) * 0.5) / Math.max(1 - Math.abs(x), 1e-12));

  // What stands where, in a state: {shape, reach, at, turn, size, scale}, null of what is not shown.
  function placed(header, state) {
    return header.objects.map((o, i) => {
      const own = state.objects[i];
      return own.visible === false
        ? null
        : {
            shape: o.shape,
            reach: o.reach_mm,
            at: own.position_mm,
            turn: Irodori.turned(own.turn_deg),
            size: o.size_mm.map((x) => x * o.scale),
            scale: o.scale,
          };
    });
  }

  // Distance along a ray to a shape that is no mesh, 0 where it misses.
  function distance(one, from, to) {
    const away = subtract(one.at, from);
    if (one.shape === "sphere") {
      const along = dot(away, to),
        square = one.reach ** 2 - dot(away, away) + along ** 2;
      if (square < 0) return 0;
      const half = Math.sqrt(square);
      return Math.max(along - half > 0 ? along - half : along + half, 0);
    }
    const axis = (c) => [one.turn[0][c], one.turn[1][c], one.turn[2][c]],
      steep = dot(to, axis(2)),
      t = steep ? dot(away, axis(2)) / steep : 0;
    if (t <= 0) return 0;
    const offset = add(scaled(to, t), away, -1),
      x = dot(offset, axis(0)),
      y = dot(offset, axis(1));
    if (one.shape === "plate" && (Math.abs(x) > 0.5 * one.size[0] || Math.abs(y) > 0.5 * one.size[1])) return 0;
    return one.shape === "disc" && x * x + y * y > one.reach ** 2 ? 0 : t;
  }

  // The nearest triangle of a mesh along a ray, nearer than `most`; as meetMesh of transport.glsl.
  function meetMesh(texels, mesh, one, ray, most) {
    const o = scaled(back(one.turn, subtract(ray.from, one.at)), 1 / one.scale),
      d = scaled(back(one.turn, ray.to), 1 / one.scale);
    const i0 = 1 / (d[0] || 1e-20),
      i1 = 1 / (d[1] || 1e-20),
      i2 = 1 / (d[2] || 1e-20);
    let found = null,
      t = most,
      node = mesh.first;
    while (node < mesh.last) {
      const n = 8 * node,
        ax = (texels[n] - o[0]) * i0,
        bx = (texels[n + 4] - o[0]) * i0,
        ay = (texels[n + 1] - o[1]) * i1,
        by = (texels[n + 5] - o[1]) * i1;
      const az = (texels[n + 2] - o[2]) * i2,
        bz = (texels[n + 6] - o[2]) * i2;
      const enter = Math.max(Math.min(ax, bx), Math.min(ay, by), Math.min(az, bz), 0),
        leave = Math.min(Math.max(ax, bx), Math.max(ay, by), Math.max(az, bz), t);
      if (enter > leave * 1.0000004) {
        node = texels[n + 3];
        continue;
      }
      const code = texels[n + 7];
      if (code >= 0) {
        const first = code >> 3;
        for (let k = first; k < first + (code & 7); k++) {
          const at = 4 * (mesh.triangles + Irodori.TRIANGLE * k),
            p = [texels[at], texels[at + 1], texels[at + 2]];
          const e = [texels[at + 4] - p[0], texels[at + 5] - p[1], texels[at + 6] - p[2]],
            f = [texels[at + 8] - p[0], texels[at + 9] - p[1], texels[at + 10] - p[2]];
          const pv = cross(d, f),
            det = dot(e, pv);
          if (det === 0) continue;
          const tv = subtract(o, p),
            u = dot(tv, pv) / det;
          if (u < 0 || u > 1) continue;
          const qv = cross(tv, e),
            v = dot(d, qv) / det,
            far = dot(f, qv) / det;
          if (v >= 0 && u + v <= 1 && far > 0 && far < t) [t, found] = [far, [e, f]];
        }
      }
      node++;
    }
    return found && { t, normal: times(one.turn, unit(cross(...found), [0, 0, 1])) };
  }

  const raised = (point, facet, reach) => add(point, facet, RISE * Math.max(...point.map(Math.abs), reach));

  // Nodes of a shape that is placed: origin, normal and facet of each, the cells between them, and the shape's grid.
  function sphereNodes(one) {
    const rows = EQUATOR / 2,
      nodes = [];
    for (let r = 0; r < rows; r++)
      for (let c = 0; c < EQUATOR; c++) {
        const turn = ((c + 0.5) * 2 * Math.PI) / EQUATOR,
          theta = ((r + 0.5) * Math.PI) / rows;
        const normal = times(one.turn, [
          Math.sin(theta) * Math.cos(turn),
          Math.sin(theta) * Math.sin(turn),
          Math.cos(theta),
        ]);
        nodes.push({ origin: raised(add(one.at, normal, one.reach), normal, one.reach), normal, facet: normal });
      }
    return { nodes, cells: quadrangles(EQUATOR, rows, true), grid: [EQUATOR, rows, 0, 0, 0, 0, 0, 0, 0, 0] };
  }

  function quadrangles(columns, rows, wraps) {
    const cells = [];
    for (let r = 0; r + 1 < rows; r++)
      for (let c = 0; c < (wraps ? columns : columns - 1); c++) {
        const a = r * columns + c,
          b = r * columns + ((c + 1) % columns);
        cells.push([a, b, a + columns, b + columns]);
      }
    return cells;
  }

  // Middle and reach of a flat shape's grid, from the points of meshes in its frame; see shadow_nodes.py.
  function middleAndReach(clouds) {
    const high = clouds.filter((points) => points.some((p) => p[2] > 0)),
      above = (high.length ? high : clouds).map((points) => points.map((p) => [p[0], p[1], Math.max(p[2], 0)]));
    const low = [Infinity, Infinity],
      top = [-Infinity, -Infinity];
    let lowest = Infinity;
    for (const points of above) {
      let least = Infinity,
        most = -Infinity;
      for (const p of points) [least, most] = [Math.min(least, p[2]), Math.max(most, p[2])];
      lowest = Math.min(lowest, least);
      for (const p of points)
        if (p[2] <= least + FOOT * (most - least))
          for (const a of [0, 1]) [low[a], top[a]] = [Math.min(low[a], p[a]), Math.max(top[a], p[a])];
    }
    const middle = [0, 1].map((a) => 0.5 * (low[a] + top[a])),
      away = [0, 0];
    for (const points of above)
      for (const p of points) for (const a of [0, 1]) away[a] = Math.max(away[a], Math.abs(p[a] - middle[a]));
    const least = Math.max(0.5 * lowest, LEAST * Math.max(...away), 1e-30);
    return [middle, [0, 1].map((a) => Math.max(0.5 * (top[a] - low[a]), 0.5 * away[a], least))];
  }

  function flatNodes(one, clouds) {
    const local = clouds.map((points) => points.map((p) => back(one.turn, subtract(p, one.at)))),
      [middle, reach] = clouds.length
        ? middleAndReach(local)
        : [
            [0, 0],
            [1, 1],
          ];
    const half = (a) => (one.shape === "disc" ? one.reach : 0.5 * one.size[a]);
    const ends = [0, 1].map((a) =>
      one.shape === "plane"
        ? [1 / SIDE - 1, 1 - 1 / SIDE]
        : [warped((-half(a) - middle[a]) / reach[a]), warped((half(a) - middle[a]) / reach[a])],
    );
    const density = ends.map(([first, last]) => (SIDE - 1) / (last - first)),
      place = (a, i) => middle[a] + reach[a] * unwarped(ends[a][0] + i / density[a]);
    const normal = times(one.turn, [0, 0, 1]),
      nodes = [];
    for (let r = 0; r < SIDE; r++)
      for (let c = 0; c < SIDE; c++) {
        const point = add(one.at, times(one.turn, [place(0, c), place(1, r), 0]));
        nodes.push({ origin: raised(point, normal, one.reach), normal, facet: normal });
      }
    return {
      nodes,
      cells: quadrangles(SIDE, SIDE, false),
      grid: [SIDE, SIDE, ...middle, ...reach, ends[0][0], ends[1][0], ...density],
    };
  }

  // Places of a mesh's nodes in its own frame, the same in every state; see mesh_shadow_nodes.py.
  function meshNodes(data, number) {
    const plane = (name) => data.planes["object/" + number + "/" + name],
      points = plane("mesh/vertices"),
      normals = plane("mesh/normals");
    const faces = plane("mesh/faces"),
      n = points.length / 3,
      m = faces.length / 3,
      parts = plane("shadow/parts"),
      corners = plane("shadow/corners");
    const three = (values, i) => [values[i], values[n + i], values[2 * n + i]],
      nodes = [],
      cells = [],
      beside = new Map(),
      names = new Map();
    const vertex = (i) => {
      const key = three(points, i).join();
      if (!names.has(key)) names.set(key, names.size);
      return names.get(key);
    };
    let start = 0;
    for (let t = 0; t < m; t++) {
      const of = [0, 1, 2].map((c) => faces[c * m + t]),
        p = of.map((i) => three(points, i)),
        normal = of.map((i) => three(normals, i)),
        count = parts[t];
      const facet = unit(cross(subtract(p[1], p[0]), subtract(p[2], p[0])), [0, 0, 1]),
        mixed = (w, values) => add(add(scaled(values[0], w[0]), values[1], w[1]), values[2], w[2]);
      for (let j = 0, place = start; j <= count; j++)
        for (let i = 0; i <= count - j; i++, place++) {
          const w = [count - i - j, i, j].map((x) => x / count),
            in_ = w.map((x) => x + (INSET / count) * (1 / 3 - x)),
            node = corners[place];
          nodes[node] ??= {
            point: mixed(in_, p),
            normal: unit(mixed(w, normal), facet),
            facet,
            corner: count === 1 ? mixed(w, p) : null,
          };
          const above = place + count + 1 - j;
          if (i + j < count) cells.push([node, corners[place + 1], corners[above]]);
          if (i + j < count - 1) cells.push([corners[above + 1], corners[above], corners[place + 1]]);
          if (count === 1) {
            const c = w.indexOf(1),
              ring = beside.get(node) ?? new Map();
            beside.set(node, ring);
            for (const other of [vertex(of[(c + 1) % 3]), vertex(of[(c + 2) % 3])])
              ring.set(other, (ring.get(other) ?? 0) + 1);
          }
        }
      start += ((count + 1) * (count + 2)) / 2;
    }
    // All about a corner whose ring of triangles is whole the surface falls away or rises.
    for (const [node, ring] of beside)
      if ([...ring.values()].every((x) => x === 2))
        Object.assign(nodes[node], { point: nodes[node].corner, facet: nodes[node].normal });
    return { nodes, cells };
  }

  function hammersley(count) {
    return Array.from({ length: count }, (_, i) => {
      let mirrored = 0;
      for (let n = i, digit = 0.5; n; n >>= 1, digit *= 0.5) mirrored += digit * (n & 1);
      return [(i + 0.5) / count, mirrored];
    });
  }

  Irodori.MovedShadows = class {
    // `mesh` and `shadows` are the textures of the renderer, with their data.
    constructor(data, mesh, shadows) {
      Object.assign(this, { data, mesh, shadows });
      this.local = {};
      this.points = {};
      this.run = 0;
      this.running = null; // the key of what is being cast
      this.found = null; // {key, data, grids, done}
    }

    static key(state) {
      return JSON.stringify(state.objects.map((one) => [one.position_mm, one.turn_deg, one.visible !== false]));
    }

    // Nodes of an object in the world, null where it is not shown or meshes hide nothing from it.
    nodes(number, all) {
      const one = all[number];
      if (!one || !this.shadows.places[number]) return null;
      if (one.shape === "sphere") return sphereNodes(one);
      if (one.shape !== "mesh")
        return flatNodes(
          one,
          all.flatMap((other, i) => (other && other.shape === "mesh" ? [this.cloud(i, other)] : [])),
        );
      const local = (this.local[number] ??= meshNodes(this.data, number)),
        turn = (v) => times(one.turn, v);
      const nodes = local.nodes.map((n) => {
        const facet = turn(n.facet);
        return {
          origin: raised(add(one.at, turn(scaled(n.point, one.scale))), facet, one.reach),
          normal: turn(n.normal),
          facet,
        };
      });
      return { nodes, cells: local.cells, grid: null };
    }

    // Corners of a mesh in the world.
    cloud(number, one) {
      const points = this.data.planes["object/" + number + "/mesh/vertices"],
        n = points.length / 3;
      return Array.from({ length: n }, (_, i) =>
        add(one.at, times(one.turn, scaled([points[i], points[n + i], points[2 * n + i]], one.scale))),
      );
    }

    // Cast rays for a state in slices of a few milliseconds, twice: few rays, then many; `shown` is called after each.
    // What was begun for another state is given up; resolves to whether this one was finished.
    async cast(state, shown) {
      const key = Irodori.MovedShadows.key(state);
      if (key === this.running) return false;
      this.running = key;
      const run = ++this.run,
        all = placed(this.data.header, state);
      const meshes = all.flatMap((one, i) =>
        one && one.shape === "mesh" ? [{ one, number: i, tree: this.mesh.places[i] }] : [],
      );
      for (const mesh of meshes) {
        const points = this.cloud(mesh.number, mesh.one),
          low = [0, 1, 2].map((a) => points.reduce((x, p) => Math.min(x, p[a]), Infinity)),
          high = [0, 1, 2].map((a) => points.reduce((x, p) => Math.max(x, p[a]), -Infinity));
        mesh.centre = scaled(add(low, high), 0.5);
        mesh.radius = points.reduce((x, p) => Math.max(x, Math.hypot(...subtract(p, mesh.centre))), 0);
      }
      const others = all.filter((one) => one && one.shape !== "mesh"),
        made = all.map((_, i) => this.nodes(i, all));
      let end = performance.now() + SLICE_MS;
      for (const count of PASSES) {
        const data = this.shadows.data.slice(),
          grids = {},
          points = hammersley(count);
        for (const [number, own] of made.entries()) {
          if (!own) continue;
          const place = this.shadows.places[number],
            layers = this.data.header.objects[number].shadow.layers,
            values = [],
            open = [];
          for (const [n, node] of own.nodes.entries()) {
            const found = this.node(node, n, points, { meshes, others, layers, own: all[number] });
            values.push(found.values);
            open.push(found.open);
            if (performance.now() > end) {
              await new Promise((go) => setTimeout(go, 0));
              if (run !== this.run) return false;
              end = performance.now() + SLICE_MS;
            }
          }
          extend(values, open, own.cells);
          values.forEach((v, n) =>
            v.forEach((x, c) => (data[4 * (place.first + n * place.stride) + c + (c > 2 ? 1 : 0)] = x)),
          );
          grids[number] = own.grid;
        }
        this.found = { key, data, grids, done: count === PASSES.at(-1) };
        if (count === PASSES.at(-1)) this.running = null;
        shown();
      }
      return true;
    }

    // The numbers of a node, and whether it lies in the open.
    node({ origin, normal, facet }, number, points, { meshes, others, layers, own }) {
      const values = new Float64Array(LAYERS + 4 * layers.length),
        count = points.length;
      const near = meshes.filter((mesh) => dot(subtract(mesh.centre, origin), normal) > -1.001 * mesh.radius);
      if (!near.length) {
        values[LEFT] = values[UNCOVERED] = 1;
        return { values, open: true };
      }
      const sign = normal[2] >= 0 ? 1 : -1,
        a = -1 / (sign + normal[2]),
        b = normal[0] * normal[1] * a;
      const tangent = [1 + sign * normal[0] ** 2 * a, sign * b, -sign * normal[0]],
        other = [b, sign + normal[1] ** 2 * a, -normal[1]];
      let free = 0,
        inside = 0;
      for (const point of points) {
        const u = (point[0] + number * 0.7548776662466927) % 1,
          turn = 2 * Math.PI * ((point[1] + number * 0.5698402909980532) % 1),
          far = Math.sqrt(u);
        let to = add(
          add(scaled(tangent, far * Math.cos(turn)), other, far * Math.sin(turn)),
          normal,
          Math.sqrt(Math.max(1 - u, 0)),
        );
        const height = dot(to, facet);
        if (height < LIFT) to = unit(add(to, facet, LIFT - height), facet);
        const ray = { from: origin, to };
        let nearest = Infinity,
          shape = null,
          hit = null,
          which = -1;
        for (const one of others) {
          const t = one === own ? 0 : distance(one, origin, to);
          if (t > 0 && t < nearest) [nearest, shape] = [t, one];
        }
        const blocked = shape !== null;
        for (const mesh of near) {
          const away = subtract(mesh.centre, origin),
            along = dot(away, to);
          if (dot(away, away) - along * along > mesh.radius ** 2) continue;
          const found = meetMesh(this.mesh.data, mesh.tree, mesh.one, ray, nearest);
          if (found) [nearest, hit, which] = [found.t, found, mesh.number];
        }
        if (!blocked) free++;
        if (hit) {
          values[HIDDEN]++;
          if (dot(hit.normal, to) < 0) {
            const at = LAYERS + 4 * (layers.includes(which) ? layers.indexOf(which) : layers.length - 1);
            values[at]++;
            for (const c of [0, 1, 2]) values[at + 1 + c] += hit.normal[c];
          } else inside++;
        } else if (blocked) {
          values[UNCOVERED]++;
          if (shape.shape === "sphere" && Math.hypot(...subtract(origin, shape.at)) < shape.reach) inside++;
        } else values[LEFT]++;
      }
      values[LEFT] = free > 0 ? values[LEFT] / free : 1;
      values[UNCOVERED] = count > free ? values[UNCOVERED] / (count - free) : 1;
      for (let i = HIDDEN; i < values.length; i++) values[i] /= count;
      return { values, open: inside < ENCLOSED * count };
    }
  };

  // Give nodes that are not in the open the mean of the open ones that they are interpolated with, where any are.
  function extend(values, open, cells) {
    const sums = new Map();
    for (const cell of cells) {
      const good = cell.filter((n) => open[n]);
      if (!good.length || good.length === cell.length) continue;
      for (const n of cell) {
        if (open[n]) continue;
        const sum = sums.get(n) ?? { total: new Float64Array(values[n].length), count: 0 };
        sums.set(n, sum);
        sum.count++;
        for (const g of good) values[g].forEach((x, c) => (sum.total[c] += x / good.length));
      }
    }
    for (const [n, sum] of sums) values[n] = sum.total.map((x) => x / sum.count);
  }
})();

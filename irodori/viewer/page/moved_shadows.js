// Shadows of meshes from all sides where something stands elsewhere than in the scene: rays from nodes, as in
// irodori/rendering/interactive/mesh_shadows.py. What is done for every ray makes no object and no array.
"use strict";
var Irodori = Irodori || {};

(function () {
  const SIDE = 128,
    EQUATOR = 64,
    RISE = 1 / 262144,
    INSET = 0.05,
    LIFT = 1e-3,
    ENCLOSED = 0.9,
    FOOT = 0.1,
    LEAST = 0.02;
  const PASSES = [16, 512],
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
            at: Float64Array.from(own.position_mm),
            turn: Irodori.turned(own.turn_deg).map((row) => Float64Array.from(row)),
            size: Float64Array.from(o.size_mm, (x) => x * o.scale),
            scale: o.scale,
          };
    });
  }

  // Distance along a ray, origin and direction in one array, to a shape that is no mesh; 0 where it misses.
  function distance({ shape, reach, at, turn, size }, ray) {
    const x = at[0] - ray[0],
      y = at[1] - ray[1],
      z = at[2] - ray[2];
    if (shape === "sphere") {
      const along = x * ray[3] + y * ray[4] + z * ray[5],
        square = reach * reach - (x * x + y * y + z * z) + along * along;
      if (square < 0) return 0;
      const half = Math.sqrt(square);
      return Math.max(along - half > 0 ? along - half : along + half, 0);
    }
    const steep = ray[3] * turn[0][2] + ray[4] * turn[1][2] + ray[5] * turn[2][2],
      t = steep ? (x * turn[0][2] + y * turn[1][2] + z * turn[2][2]) / steep : 0;
    if (t <= 0 || shape === "plane") return Math.max(t, 0);
    const px = t * ray[3] - x,
      py = t * ray[4] - y,
      pz = t * ray[5] - z,
      u = px * turn[0][0] + py * turn[1][0] + pz * turn[2][0],
      v = px * turn[0][1] + py * turn[1][1] + pz * turn[2][1];
    const isOutside =
      shape === "plate"
        ? Math.abs(u) > 0.5 * size[0] || Math.abs(v) > 0.5 * size[1]
        : shape === "disc" && u * u + v * v > reach * reach;
    return isOutside ? 0 : t;
  }

  // Whether a ray may meet a mesh: whether it goes through the sphere about it.
  function mayMeet({ centre, radius }, ray) {
    const x = centre[0] - ray[0],
      y = centre[1] - ray[1],
      z = centre[2] - ray[2],
      along = x * ray[3] + y * ray[4] + z * ray[5];
    return x * x + y * y + z * z - along * along <= radius * radius;
  }

  // The nearest triangle of a mesh along a ray, nearer than `most`; as in transport.glsl. Returns the distance,
  // 0 where there is none; the normal in the world is left in `normal`.
  function meetMesh(texels, { tree, one }, ray, most, normal) {
    const { turn, at, scale } = one,
      px = ray[0] - at[0],
      py = ray[1] - at[1],
      pz = ray[2] - at[2],
      by = 1 / scale;
    const ox = (turn[0][0] * px + turn[1][0] * py + turn[2][0] * pz) * by,
      oy = (turn[0][1] * px + turn[1][1] * py + turn[2][1] * pz) * by,
      oz = (turn[0][2] * px + turn[1][2] * py + turn[2][2] * pz) * by;
    const dx = (turn[0][0] * ray[3] + turn[1][0] * ray[4] + turn[2][0] * ray[5]) * by,
      dy = (turn[0][1] * ray[3] + turn[1][1] * ray[4] + turn[2][1] * ray[5]) * by,
      dz = (turn[0][2] * ray[3] + turn[1][2] * ray[4] + turn[2][2] * ray[5]) * by;
    const ix = 1 / (dx || 1e-20),
      iy = 1 / (dy || 1e-20),
      iz = 1 / (dz || 1e-20);
    let t = most,
      nearest = -1,
      node = tree.first;
    while (node < tree.last) {
      const n = 8 * node,
        ax = (texels[n] - ox) * ix,
        bx = (texels[n + 4] - ox) * ix,
        ay = (texels[n + 1] - oy) * iy,
        by_ = (texels[n + 5] - oy) * iy,
        az = (texels[n + 2] - oz) * iz,
        bz = (texels[n + 6] - oz) * iz;
      let enter = 0,
        leave = t;
      if (ax < bx) {
        if (ax > enter) enter = ax;
        if (bx < leave) leave = bx;
      } else {
        if (bx > enter) enter = bx;
        if (ax < leave) leave = ax;
      }
      if (ay < by_) {
        if (ay > enter) enter = ay;
        if (by_ < leave) leave = by_;
      } else {
        if (by_ > enter) enter = by_;
        if (ay < leave) leave = ay;
      }
      if (az < bz) {
        if (az > enter) enter = az;
        if (bz < leave) leave = bz;
      } else {
        if (bz > enter) enter = bz;
        if (az < leave) leave = az;
      }
      if (enter > leave * 1.0000004) {
        node = texels[n + 3];
        continue;
      }
      const code = texels[n + 7];
      if (code >= 0) {
        const first = code >> 3,
          last = first + (code & 7);
        for (let k = first; k < last; k++) {
          const i = 4 * (tree.triangles + Irodori.TRIANGLE * k),
            cx = texels[i],
            cy = texels[i + 1],
            cz = texels[i + 2];
          const ex = texels[i + 4] - cx,
            ey = texels[i + 5] - cy,
            ez = texels[i + 6] - cz,
            fx = texels[i + 8] - cx,
            fy = texels[i + 9] - cy,
            fz = texels[i + 10] - cz;
          const vx = dy * fz - dz * fy,
            vy = dz * fx - dx * fz,
            vz = dx * fy - dy * fx,
            det = ex * vx + ey * vy + ez * vz;
          if (det === 0) continue;
          const sx = ox - cx,
            sy = oy - cy,
            sz = oz - cz,
            u = (sx * vx + sy * vy + sz * vz) / det;
          if (u < 0 || u > 1) continue;
          const qx = sy * ez - sz * ey,
            qy = sz * ex - sx * ez,
            qz = sx * ey - sy * ex,
            v = (dx * qx + dy * qy + dz * qz) / det;
          if (v < 0 || u + v > 1) continue;
          const far = (fx * qx + fy * qy + fz * qz) / det;
          if (far > 0 && far < t) {
            t = far;
            nearest = i;
          }
        }
      }
      node++;
    }
    if (nearest < 0) return 0;
    const ex = texels[nearest + 4] - texels[nearest],
      ey = texels[nearest + 5] - texels[nearest + 1],
      ez = texels[nearest + 6] - texels[nearest + 2],
      fx = texels[nearest + 8] - texels[nearest],
      fy = texels[nearest + 9] - texels[nearest + 1],
      fz = texels[nearest + 10] - texels[nearest + 2];
    const x = ey * fz - ez * fy,
      y = ez * fx - ex * fz,
      z = ex * fy - ey * fx,
      length = Math.sqrt(x * x + y * y + z * z) || 1;
    for (let a = 0; a < 3; a++) normal[a] = (turn[a][0] * x + turn[a][1] * y + turn[a][2] * z) / length;
    return t;
  }

  // Whether a part of a mesh stands above the plane through a node, so that a ray from there may meet it.
  function standsAbove(texels, { tree, one }, origin, facet) {
    const n = back(one.turn, facet),
      o = scaled(back(one.turn, subtract(origin, one.at)), 1 / one.scale),
      level = dot(o, n);
    for (let node = tree.first; node < tree.last;) {
      const i = 8 * node;
      let top = -level;
      for (let a = 0; a < 3; a++) top += n[a] * texels[n[a] > 0 ? i + 4 + a : i + a];
      if (top <= 0) {
        node = texels[i + 3];
        continue;
      }
      const code = texels[i + 7];
      if (code >= 0)
        for (let k = code >> 3; k < (code >> 3) + (code & 7); k++)
          for (let c = 0; c < 3; c++) {
            const p = 4 * (tree.triangles + Irodori.TRIANGLE * k + c);
            if (n[0] * texels[p] + n[1] * texels[p + 1] + n[2] * texels[p + 2] > level) return true;
          }
      node++;
    }
    return false;
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

  // Of every point of Hammersley, in three numbers: its first, the cosine and sine of the turn that its second is.
  function hammersley(count) {
    const found = new Float64Array(3 * count);
    for (let i = 0; i < count; i++) {
      let mirrored = 0;
      for (let n = i, digit = 0.5; n; n >>= 1, digit *= 0.5) mirrored += digit * (n & 1);
      found.set([(i + 0.5) / count, Math.cos(2 * Math.PI * mirrored), Math.sin(2 * Math.PI * mirrored)], 3 * i);
    }
    return found;
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

    // Cast rays for a state in slices of a few milliseconds, twice: few rays, then as many as the renderer does;
    // `shown` is called after each. What was begun for another state is given up; resolves to whether this one was
    // finished.
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
        mesh.centre = Float64Array.from(scaled(add(low, high), 0.5));
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
        count = points.length / 3,
        texels = this.mesh.data;
      const near = meshes.filter(
        (mesh) =>
          dot(subtract(mesh.centre, origin), normal) > -1.001 * mesh.radius && standsAbove(texels, mesh, origin, facet),
      );
      if (!near.length) {
        values[LEFT] = values[UNCOVERED] = 1;
        return { values, open: true };
      }
      const sign = normal[2] >= 0 ? 1 : -1,
        a = -1 / (sign + normal[2]),
        b = normal[0] * normal[1] * a;
      const tangent = [1 + sign * normal[0] ** 2 * a, sign * b, -sign * normal[0]],
        other = [b, sign + normal[1] ** 2 * a, -normal[1]];
      const ray = new Float64Array(6),
        facing = new Float64Array(3);
      ray.set(origin);
      // Every node turns the points in its own way (Roberts' sequence): what is left of the error is noise, not steps.
      const shift = (number * 0.7548776662466927) % 1,
        turn = 2 * Math.PI * ((number * 0.5698402909980532) % 1),
        cosTurn = Math.cos(turn),
        sinTurn = Math.sin(turn);
      const [tx, ty, tz] = tangent,
        [ox, oy, oz] = other,
        [nx, ny, nz] = normal,
        [fx, fy, fz] = facet;
      let free = 0,
        inside = 0;
      for (let i = 0; i < points.length; i += 3) {
        let u = points[i] + shift;
        if (u >= 1) u -= 1;
        const far = Math.sqrt(u),
          up = Math.sqrt(1 - u),
          x = far * (points[i + 1] * cosTurn - points[i + 2] * sinTurn),
          y = far * (points[i + 2] * cosTurn + points[i + 1] * sinTurn);
        ray[3] = x * tx + y * ox + up * nx;
        ray[4] = x * ty + y * oy + up * ny;
        ray[5] = x * tz + y * oz + up * nz;
        const height = ray[3] * fx + ray[4] * fy + ray[5] * fz;
        if (height < LIFT) {
          for (let a = 0; a < 3; a++) ray[3 + a] += (LIFT - height) * facet[a];
          const length = Math.hypot(ray[3], ray[4], ray[5]);
          for (let a = 0; a < 3; a++) ray[3 + a] /= length;
        }
        let nearest = Infinity,
          shape = null,
          which = -1;
        for (let n = 0; n < others.length; n++) {
          const t = others[n] === own ? 0 : distance(others[n], ray);
          if (t > 0 && t < nearest) {
            nearest = t;
            shape = others[n];
          }
        }
        for (let n = 0; n < near.length; n++) {
          if (!mayMeet(near[n], ray)) continue;
          const t = meetMesh(texels, near[n], ray, nearest, facing);
          if (t > 0) {
            nearest = t;
            which = near[n].number;
          }
        }
        if (shape === null) free++;
        if (which >= 0) {
          values[HIDDEN]++;
          if (facing[0] * ray[3] + facing[1] * ray[4] + facing[2] * ray[5] < 0) {
            const at = LAYERS + 4 * (layers.includes(which) ? layers.indexOf(which) : layers.length - 1);
            values[at]++;
            for (let a = 0; a < 3; a++) values[at + 1 + a] += facing[a];
          } else inside++;
        } else if (shape !== null) {
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

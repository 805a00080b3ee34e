// Light maps: the light that falls on objects, with shadows and reflections between them, on texels of their surfaces.
// Rays from each texel find what it sees; the light of any room, turned by any angle, and of lamps then follows without
// tracing. As in irodori/rendering/light_transfer.py, with fewer texels. What is done for every ray makes no object.
"use strict";
var Irodori = Irodori || {};

(function () {
  // Cells of the sphere, rows by columns; columns of the sums from which those of a turned room follow; directions in a
  // cell among which texels take turns.
  const ROWS = 32,
    COLUMNS = 64,
    WIDTH = 256,
    POOL = 8;
  // Height of texels over their surface: for meshes, more than the steps in which a page has their corners.
  const RISE = 1 / 262144,
    MESH_RISE = 1 / 16384,
    ENCLOSED = 0.9,
    SLICE_MS = 12;
  // Vectors for the spectra of the light; change of the light at which no further reflection is followed; reflections.
  const VECTORS = 8,
    SETTLED = 5e-3,
    REFLECTIONS = 64;
  const BLACK = -1; // no texel
  const times = (m, v) => m.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
  const warped = (x) => (Math.abs(x) <= 1 ? 0.5 * x : Math.sign(x) * (1 - 0.5 / Math.abs(x)));
  const unwarped = (x) => (Math.abs(x) <= 0.5 ? 2 * x : (Math.sign(x) * 0.5) / Math.max(1 - Math.abs(x), 1e-12));

  // What stands where, in a state; null of what is not shown.
  function placed(data, mesh, state) {
    return data.header.objects.map((o, i) => {
      const own = state.objects[i];
      if (own.visible === false) return null;
      const one = {
        number: i,
        shape: o.shape,
        reach: o.reach_mm,
        at: Float64Array.from(own.position_mm),
        turn: Irodori.turned(own.turn_deg).map((row) => Float64Array.from(row)),
        size: Float64Array.from(o.size_mm, (x) => x * o.scale),
        scale: o.scale,
        tree: mesh ? mesh.places[i] : null,
      };
      if (o.shape === "mesh") {
        const { low, high } = one.tree;
        one.centre = times(
          one.turn,
          low.map((x, a) => 0.5 * one.scale * (x + high[a])),
        ).map((x, a) => x + one.at[a]);
        one.radius = 0.5 * one.scale * Math.hypot(...low.map((x, a) => high[a] - x));
      } else if (o.shape !== "plane") [one.centre, one.radius] = [one.at, one.reach];
      return one;
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

  // The nearest triangle of a mesh along a ray, nearer than `most`; as in transport.glsl. Returns the distance, 0 where
  // there is none; in `found` are left the normal in the world, the triangle, and the place in it.
  function meetMesh(texels, { turn, at, scale, tree }, ray, most, found) {
    const px = ray[0] - at[0],
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
      triangle = -1,
      nearU = 0,
      nearV = 0,
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
            triangle = k;
            nearU = u;
            nearV = v;
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
    for (let a = 0; a < 3; a++) found[a] = (turn[a][0] * x + turn[a][1] * y + turn[a][2] * z) / length;
    found[3] = triangle;
    found[4] = nearU;
    found[5] = nearV;
    return t;
  }

  // Texels of the map of a side of an object, every so many apart: points, normals and facets in the world, three
  // numbers each; `sign` is -1 on the back of a sheet.
  function texelsOf(data, layout, one, apart, sign) {
    const plane = (name) => data.planes["object/" + one.number + "/map/" + name],
      isMesh = one.shape === "mesh",
      rows = isMesh ? 1 : Math.ceil(layout.rows / apart),
      columns = isMesh ? plane("point").length / 3 : Math.ceil(layout.columns / apart),
      count = rows * columns,
      { grid } = layout;
    const [point, normal, facet] = [0, 1, 2].map(() => new Float64Array(3 * count));
    for (let t = 0; t < count; t++) {
      const u = ((t % columns) + 0.5) / columns,
        v = (Math.floor(t / columns) + 0.5) / rows;
      let place,
        up = [0, 0, 1],
        side = up;
      if (isMesh) {
        const three = (values) => [values[t], values[count + t], values[2 * count + t]];
        place = three(plane("point")).map((x) => x * one.scale);
        [up, side] = [three(plane("normal")), three(plane("facet"))];
      } else if (one.shape === "sphere") {
        const ring = Math.sin(Math.PI * v);
        up = side = [ring * Math.cos(2 * Math.PI * u), ring * Math.sin(2 * Math.PI * u), Math.cos(Math.PI * v)];
        place = up.map((x) => x * one.reach);
      } else if (one.shape === "plane")
        place = [grid[0] + grid[2] * unwarped(2 * u - 1), grid[1] + grid[3] * unwarped(2 * v - 1), 0];
      else place = [(u - 0.5) * one.size[0], (0.5 - v) * one.size[1], 0];
      place = times(one.turn, place).map((x, a) => x + one.at[a]);
      [up, side] = [up, side].map((values) => times(one.turn, values).map((x) => sign * x));
      const rise = (isMesh ? MESH_RISE : RISE) * Math.max(...place.map(Math.abs), one.reach);
      point.set(
        place.map((x, a) => x + rise * side[a]),
        3 * t,
      );
      normal.set(up, 3 * t);
      facet.set(side, 3 * t);
    }
    return { layout, one, rows, columns, count, point, normal, facet };
  }

  // The texel next to a place on an object, in the world; on a mesh by `found` of `meetMesh`.
  function texelAt(one, map, corners, x, y, z, found) {
    if (one.shape === "mesh") {
      const { starts, parts } = corners,
        triangle = one.tree.order[found[3]],
        n = parts[triangle],
        j = Math.round(found[5] * n),
        i = Math.min(Math.round(found[4] * n), n - j);
      const node = corners.nodes[starts[triangle] + j * (n + 1) - (j * (j - 1)) / 2 + i];
      return map.first + (corners.near ? corners.near[node] : node);
    }
    const { turn, at, size } = one,
      dx = x - at[0],
      dy = y - at[1],
      dz = z - at[2];
    const lx = turn[0][0] * dx + turn[1][0] * dy + turn[2][0] * dz,
      ly = turn[0][1] * dx + turn[1][1] * dy + turn[2][1] * dz;
    let u, v;
    if (one.shape === "sphere") {
      const lz = turn[0][2] * dx + turn[1][2] * dy + turn[2][2] * dz,
        turned = Math.atan2(ly, lx) / (2 * Math.PI);
      u = turned < 0 ? turned + 1 : turned;
      v = Math.atan2(Math.sqrt(lx * lx + ly * ly), lz) / Math.PI;
    } else if (one.shape === "plane") {
      const { grid } = map.layout;
      u = 0.5 + 0.5 * warped((lx - grid[0]) / grid[2]);
      v = 0.5 + 0.5 * warped((ly - grid[1]) / grid[3]);
    } else {
      u = lx / size[0] + 0.5;
      v = 0.5 - ly / size[1];
    }
    const column = Math.min(Math.max(Math.floor(u * map.columns), 0), map.columns - 1),
      row = Math.min(Math.max(Math.floor(v * map.rows), 0), map.rows - 1);
    return map.first + row * map.columns + column;
  }

  // Directions of the cells of the sphere, in as many ways as texels take turns.
  function directionsOf(rows, columns) {
    const out = new Float64Array(3 * POOL * rows * columns);
    for (let p = 0, at = 0; p < POOL; p++)
      for (let r = 0; r < rows; r++) {
        const top = Math.cos((Math.PI * r) / rows),
          z = top + ((Math.cos((Math.PI * (r + 1)) / rows) - top) * (p + 0.5)) / POOL,
          ring = Math.sqrt(1 - z * z);
        for (let c = 0; c < columns; c++, at += 3) {
          const turn = (2 * Math.PI * (c + ((p * 0.6180339887498949 + 0.31) % 1))) / columns;
          out.set([ring * Math.cos(turn), ring * Math.sin(turn), z], at);
        }
      }
    return out;
  }

  // The integral of the direction over each cell.
  function vectorsOf(rows, columns) {
    const out = new Float64Array(3 * rows * columns);
    for (let r = 0, at = 0; r < rows; r++) {
      const [a, b] = [r, r + 1].map((i) => (Math.PI * i) / rows),
        ring = 0.5 * (b - a) - 0.25 * (Math.sin(2 * b) - Math.sin(2 * a)),
        high = 0.5 * (Math.sin(b) ** 2 - Math.sin(a) ** 2);
      for (let c = 0; c < columns; c++, at += 3) {
        const [p, q] = [c, c + 1].map((i) => (2 * Math.PI * i) / columns);
        out.set([ring * (Math.sin(q) - Math.sin(p)), ring * (Math.cos(p) - Math.cos(q)), high * (q - p)], at);
      }
    }
    return out;
  }

  const lengthsOf = (vectors) =>
    Float64Array.from({ length: vectors.length / 3 }, (_, c) => Math.hypot(...vectors.subarray(3 * c, 3 * c + 3)));

  // The albedo of gloss and mirror at a cosine, from its values at even steps between 0.02 and 1.
  function shineAt(shine, cosine) {
    const place = Math.min(Math.max(((cosine - 0.02) / 0.98) * (shine.length - 1), 0), shine.length - 1),
      low = Math.min(Math.floor(place), shine.length - 2);
    return shine[low] + (place - low) * (shine[low + 1] - shine[low]);
  }

  // Reflectance of a surface n + ik at a cosine; as in transport.glsl.
  function fresnel(cosine, n, k) {
    const c = Math.min(Math.max(cosine, 0), 1),
      c2 = c * c,
      nk = n * k,
      s2 = (1 - c) * (1 + c),
      real = n * n - s2 - k * k,
      modulus = Math.hypot(real, 2 * nk),
      large = Math.sqrt(0.5 * (modulus + Math.abs(real))),
      small = nk / Math.max(large, 1e-18),
      [a, b2] = real >= 0 ? [large, small * small] : [small, large * large],
      square = (a + c) ** 2,
      even = modulus * c2 + s2 * s2,
      under = square * (square + b2) * (even + 2 * a * c * s2);
    if (!(under > 0)) return b2 > 0 ? 1 : 0;
    return Math.min(1, (((a * a - c2) ** 2 + b2 * square) * even) / under);
  }

  // The share of light that passes a coat, n and k, relative to that from straight above; all without a coat.
  const throughCoat = (coat, cosine) => (coat ? (1 - fresnel(cosine, ...coat)) / (1 - fresnel(1, ...coat)) : 1);

  // The cell of a ray's direction.
  function cellOf(ray, rows, columns) {
    const row = Math.floor((Math.acos(Math.min(Math.max(ray[5], -1), 1)) / Math.PI) * rows),
      turn = Math.atan2(ray[4], ray[3]) / (2 * Math.PI);
    return Math.min(row, rows - 1) * columns + (Math.floor((turn < 0 ? turn + 1 : turn) * columns) % columns);
  }

  // What the texels of a scene see: the cells that are hidden from each, and the texels that are seen in them. Cells of
  // -1 are those of texels that are seen in a mirror, and cells of -2 and less those seen in a mirror, -2 the first.
  function* traced({ data, mesh, corners }, state, [apart, wide]) {
    const all = placed(data, mesh, state),
      rows = ROWS / wide,
      columns = COLUMNS / wide,
      cells = rows * columns,
      ways = directionsOf(rows, columns),
      vectors = vectorsOf(rows, columns),
      lengths = lengthsOf(vectors),
      maps = [];
    let count = 0,
      used = 0;
    Irodori.surfaces(data.header).forEach(({ map, of, through, coat }, i) => {
      const one = all[of ?? i];
      if (!one || !map) return;
      maps[i] = { ...texelsOf(data, map, one, apart, of === undefined ? 1 : -1), first: count, through, coat };
      maps[i].index = data.header.coats[coat - 1];
      count += maps[i].count;
      if (of === undefined) one.texels = maps[i];
      else [maps[i].other, one.texels.other] = [one.texels, maps[i]];
    });
    const start = new Int32Array(count + 1),
      open = new Uint8Array(count),
      ray = new Float64Array(6),
      found = new Float64Array(6);
    let cell = new Int16Array(1 << 16),
      seen = new Int32Array(1 << 16),
      weight = new Float32Array(1 << 16);
    const lists = all.map((_, number) => all.filter((one, i) => one && (i !== number || one.tree))),
      around = (number) => lists[number];
    const grown = (old) => {
      const next = new old.constructor(2 * old.length);
      next.set(old);
      return next;
    };
    // The nearest object along the ray, the map of the side that is seen, the way to it, the texel or -1, the normal.
    let what = null,
      met = null,
      nearest = 0,
      target = BLACK;
    const facing = new Float64Array(3);
    const follow = (near) => {
      nearest = Infinity;
      what = null;
      target = BLACK;
      for (let n = 0; n < near.length; n++) {
        const other = near[n];
        let far = 0;
        if (!other.tree) far = distance(other, ray);
        else if (mayMeet(other, ray)) far = meetMesh(mesh.data, other, ray, nearest, found);
        if (far > 0 && far < nearest) {
          nearest = far;
          what = other;
        }
      }
      if (!what) return;
      const { at, turn, reach } = what,
        x = ray[0] + nearest * ray[3],
        y = ray[1] + nearest * ray[4],
        z = ray[2] + nearest * ray[5];
      for (let a = 0, place = [x, y, z]; a < 3; a++)
        facing[a] = what.tree ? found[a] : what.shape === "sphere" ? (place[a] - at[a]) / reach : turn[a][2];
      met = what.texels;
      if (facing[0] * ray[3] + facing[1] * ray[4] + facing[2] * ray[5] >= 0) {
        met = met.other; // the back of a sheet
        for (let a = 0; a < 3; a++) facing[a] = -facing[a];
      }
      if (met) target = texelAt(what, met, what.tree && corners.places[what.number], x, y, z, found);
    };
    // The share of its diffuse light that what is met lets out against the ray.
    const letOut = () =>
      met && met.index ? throughCoat(met.index, -facing[0] * ray[3] - facing[1] * ray[4] - facing[2] * ray[5]) : 1;
    const push = (c, seen_, share) => {
      if (used === cell.length) [cell, seen, weight] = [cell, seen, weight].map(grown);
      cell[used] = c;
      seen[used] = seen_;
      weight[used++] = share;
    };
    for (const map of maps) {
      if (!map) continue;
      const others = around(map.one.number);
      for (let t = 0; t < map.count; t++) {
        const own = map.first + t,
          [px, py, pz] = map.point.subarray(3 * t, 3 * t + 3),
          [nx, ny, nz] = map.normal.subarray(3 * t, 3 * t + 3),
          [fx, fy, fz] = map.facet.subarray(3 * t, 3 * t + 3);
        const near = others.filter(
          ({ centre, radius }) =>
            !centre || fx * (centre[0] - px) + fy * (centre[1] - py) + fz * (centre[2] - pz) > -1.001 * radius,
        );
        let everywhere = 0,
          inside = 0;
        for (let c = 0, w = 3 * cells * (own % POOL); c < cells; c++, w += 3) {
          const dx = ways[w],
            dy = ways[w + 1],
            dz = ways[w + 2];
          if (dx * nx + dy * ny + dz * nz <= 0) continue;
          everywhere++;
          const v = 3 * c,
            high = Math.max(vectors[v] * nx + vectors[v + 1] * ny + vectors[v + 2] * nz, 0),
            share = ((map.index ? throughCoat(map.index, high / lengths[c]) : 1) * high) / Math.PI;
          if (dx * fx + dy * fy + dz * fz <= 0) {
            push(c, BLACK, share);
            continue;
          }
          ray[0] = px;
          ray[1] = py;
          ray[2] = pz;
          ray[3] = dx;
          ray[4] = dy;
          ray[5] = dz;
          follow(near);
          if (!what) continue;
          push(c, target, share * letOut());
          if (target === BLACK) inside += Number(Boolean(what.tree) || what.shape === "sphere");
          else if (met.layout.shine) {
            // As if all that the object's gloss and mirror reflect came from one direction.
            const steep = -(facing[0] * dx + facing[1] * dy + facing[2] * dz),
              passed = share * shineAt(met.layout.shine, steep),
              rise = RISE * Math.max(what.reach, Math.abs(px), Math.abs(py), Math.abs(pz));
            for (let a = 0; a < 3; a++) {
              ray[a] += nearest * ray[3 + a] + rise * facing[a];
              ray[3 + a] += 2 * steep * facing[a];
            }
            follow(around(what.number));
            if (!what) push(-2 - cellOf(ray, rows, columns), BLACK, passed);
            else if (target !== BLACK) push(-1, target, passed * letOut());
          }
        }
        open[own] = Number(inside < ENCLOSED * everywhere);
        start[own + 1] = used;
        if (t % 16 === 0) yield;
      }
    }
    return { all, maps, rows, columns, count, start, open, cell, seen, weight };
  }

  // Sums over azimuth of a room's radiance times direction, (ROWS, WIDTH + 1, vectors of the light, 3).
  function sumsOf(data, number) {
    const name = "light/" + number + "/sky",
      plane = data.planes[name];
    if (!plane) return null;
    const [k, , side] = data.shapes[name],
      sums = new Float64Array(ROWS * (WIDTH + 1) * 3 * k),
      face_ = side * side;
    for (let face = 0, at = 0; face < 6; face++)
      for (let row = 0; row < side; row++)
        for (let column = 0; column < side; column++, at++) {
          const unit = Irodori.onFace(face, (2 * column + 1) / side - 1, (2 * row + 1) / side - 1),
            length = Math.hypot(...unit),
            [x, y, z] = unit.map((a) => a / length),
            azimuth = Math.atan2(y, x) / (2 * Math.PI);
          const band = Math.min(Math.floor((Math.acos(z) / Math.PI) * ROWS), ROWS - 1),
            place = Math.min(Math.floor((azimuth < 0 ? azimuth + 1 : azimuth) * WIDTH), WIDTH - 1),
            solid = 4 / (face_ * length ** 3);
          for (let i = 0, to = 3 * k * (band * (WIDTH + 1) + place + 1); i < k; i++, to += 3) {
            const light = plane[6 * face_ * i + at] * solid;
            sums[to] += light * x;
            sums[to + 1] += light * y;
            sums[to + 2] += light * z;
          }
        }
    for (let band = 0; band < ROWS; band++)
      for (let i = 3 * k * (band * (WIDTH + 1) + 1), end = 3 * k * (band + 1) * (WIDTH + 1); i < end; i++)
        sums[i] += sums[i - 3 * k];
    return { sums, k };
  }

  // The integrals of a turned room's radiance times direction over cells, (cells, vectors of the light, 3).
  function cellsOf({ sums, k }, turn, rows, columns) {
    const out = new Float64Array(rows * columns * 3 * k),
      each = 3 * k,
      [cosine, sine] = [Math.cos(turn), Math.sin(turn)];
    const until = (band, edge, i) => {
      const turns = Math.floor(edge / WIDTH),
        place = edge - turns * WIDTH,
        whole = Math.min(Math.floor(place), WIDTH - 1),
        first = band * (WIDTH + 1),
        at = (n) => sums[(first + n) * each + i];
      return at(whole) + (place - whole) * (at(whole + 1) - at(whole)) + turns * at(WIDTH);
    };
    for (let band = 0; band < ROWS; band++)
      for (let column = 0; column < columns; column++) {
        const edges = [column, column + 1].map((c) => (c / columns - turn / (2 * Math.PI)) * WIDTH),
          to = (Math.floor((band * rows) / ROWS) * columns + column) * each;
        for (let i = 0; i < each; i += 3) {
          const [x, y, z] = [0, 1, 2].map((a) => until(band, edges[1], i + a) - until(band, edges[0], i + a));
          out[to + i] += cosine * x - sine * y;
          out[to + i + 1] += sine * x + cosine * y;
          out[to + i + 2] += z;
        }
      }
    return out;
  }

  // Orthonormal vectors that span spectra, those of the largest rest first.
  function spanning(spectra) {
    const rest = spectra.map((one) => Float64Array.from(one)),
      square = (one) => one.reduce((sum, x) => sum + x * x, 0),
      out = [];
    while (out.length < VECTORS) {
      const sizes = rest.map(square),
        most = Math.max(...sizes);
      if (!(most > 1e-12 * square(spectra[0]))) break;
      const unit = rest[sizes.indexOf(most)].map((x) => x / Math.sqrt(most));
      out.push(unit);
      for (const one of rest) {
        const part = inner(one, unit);
        for (let i = 0; i < 61; i++) one[i] -= part * unit[i];
      }
    }
    return out;
  }

  const inner = (a, b, c) => {
    let sum = 0;
    for (let i = 0; i < 61; i++) sum += a[i] * b[i] * (c ? c[i] : 1);
    return sum;
  };
  const norm = (values) => Math.sqrt(values.reduce((sum, x) => sum + x * x, 0) / Math.max(values.length, 1));

  // What texels send: their own light by their colour, and through a sheet that of the texels on its other side by its
  // transmittance. `from` is the map of this light, and `number` the row of the material.
  const partsOf = (maps) =>
    maps.flatMap((map, number) => {
      if (!map) return [];
      const own = { map, from: map, number };
      return map.through == null ? [own] : [own, { map, from: map.other, number: map.through }];
    });

  Irodori.LightMaps = class {
    // `mesh` and `corners` are textures of the renderer, with their data.
    constructor(data, spectra, mesh, corners) {
      Object.assign(this, { data, spectra, mesh, corners });
      this.sums = {};
      this.transfers = {}; // by fineness: {key, transfer} of the last arrangement
      this.run = 0;
    }

    static arrangement(state) {
      return JSON.stringify(state.objects.map((one) => [one.position_mm, one.turn_deg, one.visible !== false]));
    }

    // What is known of an arrangement, null where nothing yet. Fineness is how many times coarser texels and cells are.
    transfer(state, fineness) {
      const kept = this.transfers[fineness];
      return kept && kept.key === Irodori.LightMaps.arrangement(state) ? kept.transfer : null;
    }

    // Trace at once.
    trace(state, fineness) {
      const steps = traced(this, state, fineness);
      for (let step = steps.next(); ; step = steps.next()) if (step.done) return this.keep(state, fineness, step.value);
    }

    // Trace in slices of a few milliseconds; what was begun for another state is given up. Null where it was.
    async traceSlowly(state, fineness) {
      const run = ++this.run,
        steps = traced(this, state, fineness);
      let end = performance.now() + SLICE_MS;
      for (;;) {
        const step = steps.next();
        if (step.done) return this.keep(state, fineness, step.value);
        if (performance.now() < end) continue;
        await new Promise((go) => setTimeout(go, 0));
        if (run !== this.run) return null;
        end = performance.now() + SLICE_MS;
      }
    }

    keep(state, fineness, transfer) {
      this.transfers[fineness] = { key: Irodori.LightMaps.arrangement(state), transfer };
      return transfer;
    }

    // Light from the room on the texels, by the vectors of its light: without obstacles, less that of hidden cells.
    fromRoom(transfer, number, turn) {
      const { maps, count, start, cell, weight, rows, columns } = transfer,
        k = this.spectra.lights[number].basis.length,
        out = new Float64Array(count * k);
      this.sums[number] ??= sumsOf(this.data, number) ?? false;
      if (!this.sums[number]) return out;
      const cells = cellsOf(this.sums[number], turn, rows, columns),
        name = "light/" + number + "/irradiance",
        width = this.data.shapes[name][2],
        size = 6 * width ** 2,
        [cosine, sine] = [Math.cos(turn), Math.sin(turn)],
        lost = new Float64Array(3 * k),
        mirrored = new Float64Array(k),
        vectors = vectorsOf(rows, columns),
        lengths = lengthsOf(vectors);
      for (const map of maps) {
        if (!map) continue;
        const irradiance = this.data.planes[map.coat ? name + "/" + (map.coat - 1) : name],
          channels = Array.from({ length: k }, (_, i) => irradiance.subarray(i * size, (i + 1) * size));
        for (let t = 0; t < map.count; t++) {
          const own = map.first + t,
            [x, y, z] = map.normal.subarray(3 * t, 3 * t + 3),
            unit = [cosine * x + sine * y, cosine * y - sine * x, z];
          lost.fill(0);
          mirrored.fill(0);
          for (let e = start[own]; e < start[own + 1]; e++)
            if (cell[e] >= 0) {
              const c = cell[e],
                v = 3 * c,
                high = vectors[v] * x + vectors[v + 1] * y + vectors[v + 2] * z,
                by = map.index ? throughCoat(map.index, high / lengths[c]) : 1;
              for (let i = 0, at = k * v; i < 3 * k; i++, at++) lost[i] += by * cells[at];
            } else if (cell[e] < -1)
              for (let i = 0, c = -2 - cell[e], at = 3 * k * c; i < k; i++, at += 3) {
                const [a, b, d] = [vectors[3 * c], vectors[3 * c + 1], vectors[3 * c + 2]],
                  radiance = (cells[at] * a + cells[at + 1] * b + cells[at + 2] * d) / (a * a + b * b + d * d);
                mirrored[i] += weight[e] * radiance;
              }
          for (let i = 0; i < k; i++) {
            const free = Irodori.lookUpCube(channels[i], width, width - 2, unit, 1);
            out[own * k + i] =
              (free - lost[3 * i] * x - lost[3 * i + 1] * y - lost[3 * i + 2] * z) / Math.PI + mirrored[i];
          }
        }
      }
      return out;
    }

    // Light of a lamp on the texels, for a spectrum of 1: `place` is a direction and -1, or a position and a radius.
    fromLamp({ all, maps, count }, place, level) {
      const out = new Float64Array(count),
        ray = new Float64Array(6),
        found = new Float64Array(6);
      for (const map of maps)
        for (let t = 0; map && t < map.count; t++) {
          for (let a = 0; a < 3; a++) {
            ray[a] = map.point[3 * t + a];
            ray[3 + a] = place[3] < 0 ? place[a] : place[a] - ray[a];
          }
          const far = place[3] < 0 ? Infinity : Math.hypot(ray[3], ray[4], ray[5]);
          if (far < Infinity) for (let a = 3; a < 6; a++) ray[a] /= far;
          const cosine = [0, 1, 2].reduce((sum, a) => sum + ray[3 + a] * map.normal[3 * t + a], 0),
            height = [0, 1, 2].reduce((sum, a) => sum + ray[3 + a] * map.facet[3 * t + a], 0);
          if (cosine <= 0 || height <= 0) continue;
          const isHidden = all.some((other) => {
            if (!other || (other === map.one && !other.tree)) return false;
            const met = !other.tree
              ? distance(other, ray)
              : mayMeet(other, ray)
                ? meetMesh(this.mesh.data, other, ray, far, found)
                : 0;
            return met > 0 && met < far;
          });
          if (isHidden) continue;
          const falls = cosine * throughCoat(map.index, cosine);
          out[map.first + t] = (falls * level) / (far < Infinity ? far * far : 1) / Math.PI;
        }
      return out;
    }

    // Coefficients of the reflectances at an object's texels, (texels, vectors of the surface).
    reflectances(map, number) {
      const bases = this.spectra.objects[number].basis.length,
        plane = this.data.planes["object/" + number + "/map/colour"],
        all = plane.length / bases,
        { rows, columns } = map.layout,
        out = new Float64Array(map.count * bases);
      for (let t = 0; t < map.count; t++) {
        const row = Math.floor(((Math.floor(t / map.columns) + 0.5) * rows) / map.rows),
          column = Math.floor((((t % map.columns) + 0.5) * columns) / map.columns),
          at = map.one.tree ? t : row * columns + column;
        for (let j = 0; j < bases; j++) out[t * bases + j] = plane[j * all + at];
      }
      return out;
    }

    // The light on all texels under a state's light, as coefficients of vectors: {vectors, light}.
    light(transfer, state, lamps) {
      const { maps, count, start, open, seen, weight } = transfer,
        constants = this.spectra.constants(state.light, state.observer, false),
        turn = ((state.light.turn_deg || 0) * Math.PI) / 180,
        k = constants.basis.length,
        room = this.fromRoom(transfer, constants.number, turn),
        lit = constants.spectra.map((_, l) => this.fromLamp(transfer, lamps.places.subarray(4 * l), lamps.levels[l])),
        parts = partsOf(maps).map((part) => ({ ...part, colours: this.reflectances(part.map, part.number) }));
      // Vectors for the light of all sources, once and twice reflected.
      const scaled = (spectrum, by) => Array.from(spectrum, (x) => x * by),
        sources = [
          ...constants.basis.map((e, i) => scaled(e, norm(room.filter((_, n) => n % k === i)))),
          ...constants.spectra.map((e, l) => scaled(e, norm(lit[l]))),
        ],
        mirrors = parts.flatMap(({ number, colours }) =>
          this.spectra.objects[number].basis.map((s, j, { length }) =>
            scaled(s, norm(colours.filter((_, n) => n % length === j))),
          ),
        ),
        products = (some) => some.flatMap((e) => mirrors.map((s) => e.map((x, i) => x * s[i]))),
        once = products(sources),
        vectors = spanning([...sources, ...once, ...products(spanning(once).map((e) => scaled(e, norm(sources[0]))))]),
        K = vectors.length;
      const light = new Float64Array(count * K),
        onto = (spectrum) => vectors.map((v) => inner(spectrum, v)),
        roomOnto = constants.basis.map(onto),
        lampOnto = constants.spectra.map(onto);
      for (let t = 0; t < count; t++)
        for (let i = 0; i < k; i++) for (let c = 0; c < K; c++) light[t * K + c] += room[t * k + i] * roomOnto[i][c];
      const source = light.slice();
      lit.forEach((one, l) =>
        one.forEach((x, t) => {
          if (x) for (let c = 0; c < K; c++) source[t * K + c] += x * lampOnto[l][c];
        }),
      );
      // How a texel's colour changes the coefficients.
      for (const part of parts) {
        const { basis } = this.spectra.objects[part.number],
          each = basis.map((s) => vectors.flatMap((a) => vectors.map((b) => inner(a, b, s))));
        part.sending = new Float32Array(part.map.count * K * K);
        for (let t = 0; t < part.map.count; t++)
          each.forEach((matrix, j) => {
            const by = part.colours[t * basis.length + j];
            for (let i = 0, at = t * K * K; i < K * K; i++) part.sending[at + i] += by * matrix[i];
          });
      }
      let reflected = new Float64Array(count * K);
      const sent = new Float64Array(count * K),
        settled = SETTLED * norm(source);
      for (let n = 0; n < REFLECTIONS; n++) {
        sent.fill(0);
        for (const { map, from, sending } of parts)
          for (let t = 0; t < map.count; t++)
            for (let c = 0, lit = (from.first + t) * K; c < K; c++) {
              let sum = 0;
              for (let d = 0, at = (t * K + c) * K; d < K; d++)
                sum += sending[at + d] * (source[lit + d] + reflected[lit + d]);
              sent[(map.first + t) * K + c] += sum;
            }
        const next = new Float64Array(count * K);
        let most = 0;
        for (let t = 0; t < count; t++) {
          for (let e = start[t]; e < start[t + 1]; e++) {
            const from = seen[e] * K,
              to = t * K;
            if (from >= 0) for (let c = 0; c < K; c++) next[to + c] += weight[e] * sent[from + c];
          }
          for (let c = t * K; c < (t + 1) * K; c++) most = Math.max(most, Math.abs(next[c] - reflected[c]));
        }
        reflected = next;
        if (most <= settled) break;
      }
      for (let i = 0; i < light.length; i++) light[i] += reflected[i];
      for (const map of maps) if (map && !map.one.tree) extend(light, open, map, K);
      return { vectors, light };
    }

    // The texture of a state's light: `wide` texels for each of the maps', made by `shown` of an object and the
    // vectors, (numbers, vectors); where the map of each side begins in it, and that of the light on its other side.
    texture(transfer, state, lamps, wide, shown) {
      const { vectors, light } = this.light(transfer, state, lamps),
        K = vectors.length,
        near = (map) => map.one.tree && this.corners.places[map.one.number],
        parts = partsOf(transfer.maps),
        sizes = parts.map(({ map }) => (near(map) ? near(map).count : map.count)),
        rows = Math.ceil((wide * sizes.reduce((sum, n) => sum + n, 0)) / 2048),
        data = new Float32Array(4 * 2048 * Math.max(rows, 1)),
        places = [],
        passed = [];
      let first = 0;
      parts.forEach(({ map, from, number }, part) => {
        const matrix = shown(number, vectors),
          numbers = matrix.length,
          own = new Float64Array(numbers * map.count);
        for (let t = 0; t < map.count; t++)
          for (let n = 0; n < numbers; n++) {
            let sum = 0;
            for (let c = 0, at = (from.first + t) * K; c < K; c++) sum += matrix[n][c] * light[at + c];
            own[t * numbers + n] = sum;
          }
        const spread = near(map) && near(map).share;
        for (let t = 0; t < sizes[part]; t++)
          for (let n = 0; n < numbers; n++) {
            let sum = spread ? 0 : own[t * numbers + n];
            if (spread)
              for (let c = 0, size = sizes[part]; c < spread.length / size; c++)
                sum += spread[c * size + t] * own[near(map).near[c * size + t] * numbers + n];
            data[4 * (first + t * wide) + n] = sum;
          }
        if (from === map) places[number] = [first, map.rows, map.columns];
        else passed[transfer.maps.indexOf(map)] = first;
        first += wide * sizes[part];
      });
      return { data, width: 2048, height: Math.max(rows, 1), places, passed };
    }
  };

  // Give texels within other objects the mean of the open ones beside them, where any are.
  function extend(light, open, { first, rows, columns, one }, K) {
    const wraps = one.shape === "sphere",
      before = light.slice(first * K, (first + rows * columns) * K);
    for (let t = 0; t < rows * columns; t++) {
      if (open[first + t]) continue;
      const good = [];
      for (let r = Math.max(Math.floor(t / columns) - 1, 0); r <= Math.min(Math.floor(t / columns) + 1, rows - 1); r++)
        for (const c of [-1, 0, 1].map((by) => (t % columns) + by))
          if (wraps || (c >= 0 && c < columns)) {
            const beside = r * columns + ((c + columns) % columns);
            if (open[first + beside]) good.push(beside);
          }
      if (good.length)
        for (let c = 0; c < K; c++)
          light[(first + t) * K + c] = good.reduce((sum, n) => sum + before[n * K + c], 0) / good.length;
    }
  }
})();

// Draws lit shapes with one shadow, in WebGL 2.
"use strict";

const SHADOW_SIZE = 2048;
const SUN = V.unit([-0.45, -0.55, 1.0]);
const BACKGROUND = [0.925, 0.933, 0.945];

const VERTEX = `#version 300 es
layout(location=0) in vec3 position; layout(location=1) in vec3 normal; layout(location=2) in vec2 texture_at;
uniform mat4 model, view, sun; uniform float lift;
out vec3 world, outward; out vec4 lit_at; out vec2 uv;
void main() {
  vec4 p = model * vec4(position, 1.0);
  world = p.xyz; outward = mat3(model) * normal; lit_at = sun * p; uv = texture_at;
  gl_Position = view * p; gl_Position.z -= lift * gl_Position.w;
}`;

const FRAGMENT = `#version 300 es
precision highp float; precision highp sampler2DShadow;
in vec3 world, outward; in vec4 lit_at; in vec2 uv; out vec4 colour;
uniform vec4 tint; uniform vec3 eye, to_sun, background, colours[4]; uniform int kind;
uniform sampler2DShadow shadow; uniform sampler2D regions;
float lit(float slope) {
  vec3 at = lit_at.xyz / lit_at.w * 0.5 + 0.5;
  if (any(greaterThan(abs(at.xy - 0.5), vec2(0.5)))) return 1.0;
  float sum = 0.0;
  for (int i = -1; i <= 1; i++) for (int j = -1; j <= 1; j++)
    sum += texture(shadow, vec3(at.xy + vec2(i, j) * 1.2 / ${SHADOW_SIZE}.0, at.z - 0.0009 - 0.0012 * slope));
  return sum / 9.0;
}
void main() {
  if (kind == 1) { colour = tint; return; }
  if (kind == 2) {
    int bits = int(texture(regions, uv).r * 255.0 + 0.5);
    if ((bits & 3) != 0) { colour = vec4((bits & 1) != 0 ? colours[0] : colours[1], 0.55 * tint.a); return; }
    bool stripe = fract((gl_FragCoord.x + gl_FragCoord.y) / 9.0) < 0.22;
    if ((bits & 4) == 0 || !stripe) discard;
    colour = vec4(colours[2], 0.6 * tint.a);
    return;
  }
  vec3 n = normalize(outward), toward = normalize(eye - world);
  if (dot(n, toward) < 0.0) n = -n;
  float facing = max(dot(n, to_sun), 0.0);
  vec3 sky = mix(vec3(0.34, 0.33, 0.33), vec3(0.50, 0.52, 0.55), n.z * 0.5 + 0.5);
  float shine = pow(max(dot(n, normalize(to_sun + toward)), 0.0), 40.0) * 0.10;
  float sunlight = facing > 0.0 ? facing * lit(1.0 - facing) : 0.0;
  vec3 base = pow(tint.rgb, vec3(2.2));
  if (kind == 3) {
    vec2 line = abs(fract(world.xy * 2.0 - 0.5) - 0.5) / fwidth(world.xy * 2.0);
    base *= 1.0 - 0.10 * (1.0 - min(min(line.x, line.y), 1.0));
  }
  vec3 light = base * (sky + 0.50 * sunlight) + shine * sunlight;
  colour = vec4(pow(light, vec3(1.0 / 2.2)), tint.a);
  if (kind == 3) colour.rgb = mix(colour.rgb, background, smoothstep(2.5, 7.0, length(world.xy)));
}`;

const SHADOW_VERTEX = `#version 300 es
layout(location=0) in vec3 position; uniform mat4 model, sun;
void main() { gl_Position = sun * model * vec4(position, 1.0); }`;
const SHADOW_FRAGMENT = `#version 300 es
precision highp float; void main() {}`;

const KIND = { lit: 0, plain: 1, regions: 2, floor: 3 };

class Renderer {
  constructor(canvas) {
    this.canvas = canvas;
    this.gl = canvas.getContext("webgl2", { antialias: true, alpha: false, preserveDrawingBuffer: true });
    if (!this.gl) throw new Error("this browser has no WebGL 2; the scene cannot be drawn");
    this.program = this.link(VERTEX, FRAGMENT);
    this.shadowProgram = this.link(SHADOW_VERTEX, SHADOW_FRAGMENT);
    this.makeShadow();
    this.sun = M.multiply(M.box(2.6, 0.1, 12), M.lookAt(V.add([0, 0, 0.4], V.scale(SUN, 6)), [0, 0, 0.4], [0, 0, 1]));
    this.blank = this.texture(new Uint8Array([0]), 1, 1);
  }

  link(vertex, fragment) {
    const gl = this.gl;
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    const places = new Map();
    return { program, at: (name) => {
      if (!places.has(name)) places.set(name, gl.getUniformLocation(program, name));
      return places.get(name);
    } };
  }

  makeShadow() {
    const gl = this.gl;
    this.shadow = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.shadow);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.DEPTH_COMPONENT24, SHADOW_SIZE, SHADOW_SIZE);
    for (const [name, value] of [
      [gl.TEXTURE_MIN_FILTER, gl.LINEAR], [gl.TEXTURE_MAG_FILTER, gl.LINEAR],
      [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
      [gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE], [gl.TEXTURE_COMPARE_FUNC, gl.LEQUAL],
    ]) gl.texParameteri(gl.TEXTURE_2D, name, value);
    this.shadowFrame = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.shadowFrame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, this.shadow, 0);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  // A texture of one byte a cell.
  texture(cells, width, height) {
    const gl = this.gl;
    const made = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, made);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R8, width, height, 0, gl.RED, gl.UNSIGNED_BYTE, cells);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
    return made;
  }

  // Upload a shape; what `draw` takes as `mesh`.
  upload(shape) {
    const gl = this.gl;
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    for (const [place, values, width] of [[0, shape.positions, 3], [1, shape.normals, 3], [2, shape.texture, 2]]) {
      if (!values) continue;
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(values), gl.STATIC_DRAW);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, width, gl.FLOAT, false, 0, 0);
    }
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(shape.indices), gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    return { array, count: shape.indices.length };
  }

  // Draw items {mesh, matrix, colour [r, g, b, a], kind, lift, texture}; `colours` are those of the regions.
  draw(items, view, eye, colours) {
    const gl = this.gl;
    const solid = items.filter((item) => item.kind === KIND.lit && item.colour[3] === 1);
    gl.enable(gl.DEPTH_TEST);
    this.drawShadow(solid);
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.clearColor(...BACKGROUND, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const { program, at } = this.program;
    gl.useProgram(program);
    gl.uniformMatrix4fv(at("view"), false, view);
    gl.uniformMatrix4fv(at("sun"), false, this.sun);
    gl.uniform3fv(at("eye"), eye);
    gl.uniform3fv(at("to_sun"), SUN);
    gl.uniform3fv(at("background"), BACKGROUND);
    gl.uniform3fv(at("colours[0]"), colours.flat());
    gl.uniform1i(at("shadow"), 0);
    gl.uniform1i(at("regions"), 1);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.shadow);
    gl.activeTexture(gl.TEXTURE1);
    const floor = items.filter((item) => item.kind === KIND.floor);
    const marks = items.filter((item) => item.kind !== KIND.floor && (item.kind !== KIND.lit || item.colour[3] < 1));
    for (const item of [...solid, ...floor]) this.drawItem(item);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.depthMask(false);
    for (const item of marks) this.drawItem(item);
    gl.depthMask(true);
    gl.disable(gl.BLEND);
  }

  drawShadow(items) {
    const gl = this.gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.shadowFrame);
    gl.viewport(0, 0, SHADOW_SIZE, SHADOW_SIZE);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    gl.useProgram(this.shadowProgram.program);
    gl.uniformMatrix4fv(this.shadowProgram.at("sun"), false, this.sun);
    for (const item of items) {
      gl.uniformMatrix4fv(this.shadowProgram.at("model"), false, item.matrix);
      gl.bindVertexArray(item.mesh.array);
      gl.drawElements(gl.TRIANGLES, item.mesh.count, gl.UNSIGNED_INT, 0);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  drawItem(item) {
    const gl = this.gl;
    const { at } = this.program;
    gl.uniformMatrix4fv(at("model"), false, item.matrix);
    gl.uniform4fv(at("tint"), item.colour);
    gl.uniform1i(at("kind"), item.kind);
    gl.uniform1f(at("lift"), item.lift || 0);
    gl.bindTexture(gl.TEXTURE_2D, item.texture || this.blank);
    gl.bindVertexArray(item.mesh.array);
    gl.drawElements(gl.TRIANGLES, item.mesh.count, gl.UNSIGNED_INT, 0);
  }
}

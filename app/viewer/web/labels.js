// viser's labels are black on a white plate. On a dark page they are white on a dark one: their two
// shaders get a uniform, which is set anew whenever they draw.
{
  const SHADES = [
    ['vec4(0.0, 0.0, 0.0, a)', 'vec4(vec3(0.93 * onDark), a)'],  // letters
    ['vec4(1.0, 1.0, 1.0, 0.85 * vAlpha)', 'vec4(vec3(1.0 - 0.95 * onDark), 0.85 * vAlpha)'],
  ];
  const context = WebGL2RenderingContext.prototype;
  const {shaderSource, useProgram} = context;
  const places = new WeakMap();  // of the uniform, by program
  context.shaderSource = function (shader, text) {
    const shade = SHADES.find(([from]) => text.includes(`gl_FragColor = ${from};`));
    if (shade) {
      text = text.replace(...shade).replace('void main()', 'uniform float onDark;\nvoid main()');
    }
    shaderSource.call(this, shader, text);
  };
  context.useProgram = function (program) {
    useProgram.call(this, program);
    if (!program) return;
    if (!places.has(program)) places.set(program, this.getUniformLocation(program, 'onDark'));
    const place = places.get(program);
    if (!place) return;
    const {mantineColorScheme} = document.documentElement.dataset;
    this.uniform1f(place, mantineColorScheme === 'dark' ? 1 : 0);
  };
}

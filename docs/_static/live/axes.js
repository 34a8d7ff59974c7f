// Axes of a figure on a canvas: a frame with ticks and labels, and lines and bars in the units of the data.
"use strict";
(() => {
  const TEXT = 13; // px
  const GAP = 6;

  /** Multiples of 1, 2 or 5 times a power of ten from `low` to `high`, at most `most` of them, and their decimals. */
  function ticks(low, high, most) {
    const rough = (high - low) / Math.max(most, 1);
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((factor) => factor * power).find((step) => step >= rough * (1 - 1e-9));
    const first = Math.ceil(low / step - 1e-9);
    const number = Math.floor(high / step + 1e-9) - first + 1;
    const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    return { decimals, values: Array.from({ length: Math.max(number, 0) }, (_, index) => (first + index) * step) };
  }

  /** Minus signs as they are set. */
  function shown(value, decimals) {
    return (Math.abs(value) < 1e-12 ? 0 : value).toFixed(decimals).replace("-", "\u2212");
  }

  class Axes {
    /** Clears the canvas, and draws the frame: `x`, `y` are the limits [low, high], `xlabel`, `ylabel` the names. */
    constructor(canvas, { x, y, xlabel, ylabel }) {
      const ratio = globalThis.devicePixelRatio || 1;
      const { clientWidth: width, clientHeight: height } = canvas;
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
      this.context = canvas.getContext("2d");
      this.context.scale(ratio, ratio);
      const style = getComputedStyle(canvas);
      this.colors = (name) => style.getPropertyValue(`--live-${name}`).trim();
      this.context.font = `${TEXT}px ${style.fontFamily}`;
      Object.assign(this, { limits: { x, y } });
      const below = ticks(...x, Math.max(2, (width - 60) / 70));
      const beside = ticks(...y, Math.max(2, (height - 50) / 42));
      const names = beside.values.map((value) => shown(value, beside.decimals));
      const widest = Math.max(...names.map((name) => this.context.measureText(name).width));
      const bottom = height - 2 * TEXT - 3 * GAP;
      this.box = { left: TEXT + 2 * GAP + widest, top: GAP + 2, right: width - 14, bottom };
      this.frame(below, beside, names);
      this.names(xlabel, ylabel, height);
    }

    atX(value) {
      const { left, right } = this.box;
      return left + ((value - this.limits.x[0]) / (this.limits.x[1] - this.limits.x[0])) * (right - left);
    }

    atY(value) {
      const { top, bottom } = this.box;
      return bottom - ((value - this.limits.y[0]) / (this.limits.y[1] - this.limits.y[0])) * (bottom - top);
    }

    frame(below, beside, names) {
      const { context } = this;
      const { left, top, right, bottom } = this.box;
      context.lineWidth = 1;
      context.strokeStyle = this.colors("grid");
      context.fillStyle = this.colors("text");
      context.textBaseline = "top";
      context.textAlign = "center";
      context.beginPath();
      for (const value of below.values) {
        context.moveTo(this.atX(value), top);
        context.lineTo(this.atX(value), bottom);
        context.fillText(shown(value, below.decimals), this.atX(value), bottom + GAP);
      }
      context.textBaseline = "middle";
      context.textAlign = "right";
      beside.values.forEach((value, index) => {
        context.moveTo(left, this.atY(value));
        context.lineTo(right, this.atY(value));
        context.fillText(names[index], left - GAP, this.atY(value));
      });
      context.stroke();
      context.strokeStyle = this.colors("text");
      context.strokeRect(left, top, right - left, bottom - top);
    }

    names(xlabel, ylabel, height) {
      const { context } = this;
      const { left, top, right, bottom } = this.box;
      context.textAlign = "center";
      context.textBaseline = "bottom";
      context.fillText(xlabel, (left + right) / 2, height - 1);
      context.save();
      context.translate(0, (top + bottom) / 2);
      context.rotate(-Math.PI / 2);
      context.textBaseline = "top";
      context.fillText(ylabel, 0, 0);
      context.restore();
    }

    /** Calls `draw` with what it draws kept inside the frame. */
    inside(draw) {
      const { left, top, right, bottom } = this.box;
      this.context.save();
      this.context.beginPath();
      this.context.rect(left, top, right - left, bottom - top);
      this.context.clip();
      draw();
      this.context.restore();
    }

    /** Lines through points [x, y], each line on its own. */
    lines(lines, color, width, dash = []) {
      const { context } = this;
      this.inside(() => {
        context.strokeStyle = this.colors(color);
        context.lineWidth = width;
        context.lineJoin = context.lineCap = dash.length ? "butt" : "round";
        context.setLineDash(dash);
        context.beginPath();
        for (const line of lines) {
          line.forEach(([x, y], index) => context[index ? "lineTo" : "moveTo"](this.atX(x), this.atY(y)));
        }
        context.stroke();
      });
    }

    crosses(points, color) {
      const { context } = this;
      context.strokeStyle = this.colors(color);
      context.lineWidth = 2;
      context.beginPath();
      for (const [x, y] of points) {
        for (const turn of [-1, 1]) {
          context.moveTo(this.atX(x) - 5, this.atY(y) - 5 * turn);
          context.lineTo(this.atX(x) + 5, this.atY(y) + 5 * turn);
        }
      }
      context.stroke();
    }

    dots(points, color, radius) {
      const { context } = this;
      context.fillStyle = this.colors(color);
      for (const [x, y] of points) {
        context.beginPath();
        context.arc(this.atX(x), this.atY(y), radius, 0, 2 * Math.PI);
        context.fill();
      }
    }

    bars(width, heights, color) {
      this.inside(() => {
        this.context.fillStyle = this.colors(color);
        heights.forEach((height, index) => {
          const left = this.atX(index * width);
          const wide = this.atX((index + 1) * width) - left;
          const top = this.atY(height);
          this.context.fillRect(left, top, Math.max(wide - 0.5, 0.5), this.box.bottom - top); // a gap between bars
        });
      });
    }

    /** A sentence in the middle. */
    say(text) {
      const { left, top, right, bottom } = this.box;
      this.context.fillStyle = this.colors("text");
      this.context.textAlign = "center";
      this.context.textBaseline = "middle";
      this.context.fillText(text, (left + right) / 2, (top + bottom) / 2);
    }
  }

  globalThis.stickslip.axes = { Axes, ticks };
})();

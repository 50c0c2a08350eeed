//! A canvas on which textures are painted, in metres from the lower left corner.

use super::lettering;
use super::noise::Grain;
use super::texture::Texel;

/// Red, green and blue.
pub(super) type Colour = [u8; 3];

/// A rectangle in metres; `bottom` is below `top`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Area {
    pub(super) left: f32,
    pub(super) bottom: f32,
    pub(super) right: f32,
    pub(super) top: f32,
}

impl Area {
    /// The area with its lower left corner at (`left`, `bottom`).
    pub(super) fn new(left: f32, bottom: f32, width: f32, height: f32) -> Self {
        Self { left, bottom, right: left + width, top: bottom + height }
    }

    /// The area of `width` × `height` around the middle of a line at height `bottom`.
    pub(super) fn centred(middle: f32, bottom: f32, width: f32, height: f32) -> Self {
        Self::new(middle - width / 2.0, bottom, width, height)
    }

    pub(super) fn width(self) -> f32 {
        self.right - self.left
    }

    pub(super) fn height(self) -> f32 {
        self.top - self.bottom
    }

    pub(super) fn middle(self) -> f32 {
        (self.left + self.right) / 2.0
    }

    /// Smaller by `margin` on every side.
    pub(super) fn inset(self, margin: f32) -> Self {
        Self {
            left: self.left + margin,
            bottom: self.bottom + margin,
            right: self.right - margin,
            top: self.top - margin,
        }
    }

    /// The part between the given fractions of width (left, right) and height (bottom, top).
    pub(super) fn part(self, (left, right): (f32, f32), (bottom, top): (f32, f32)) -> Self {
        Self {
            left: self.left + left * self.width(),
            right: self.left + right * self.width(),
            bottom: self.bottom + bottom * self.height(),
            top: self.bottom + top * self.height(),
        }
    }
}

/// `colour` times `factor`.
pub(super) fn scaled(colour: Colour, factor: f32) -> Colour {
    colour.map(|channel| (f32::from(channel) * factor).clamp(0.0, 255.0) as u8)
}

/// The colour `fraction` of the way from `from` to `to`.
pub(super) fn blend(from: Colour, to: Colour, fraction: f32) -> Colour {
    let channel = |c: usize| f32::from(from[c]) + (f32::from(to[c]) - f32::from(from[c])) * fraction;
    [channel(0) as u8, channel(1) as u8, channel(2) as u8]
}

/// A painting surface of `width_px` × `height_px` texels.
#[derive(Clone, Debug)]
pub(super) struct Canvas {
    width_px: usize,
    height_px: usize,
    px_per_metre: f32,
    /// What painting writes into the fourth byte: 0 on walls (no glow), 255 in sprites (opaque).
    fourth: u8,
    texels: Vec<Texel>,
}

impl Canvas {
    /// A wall of one colour.
    pub(super) fn wall(size_metres: (f32, f32), px_per_metre: f32, colour: Colour) -> Self {
        Self::new(size_metres, px_per_metre, colour, 0)
    }

    /// A sprite, wholly transparent; `colour` is what its soft edges fade to.
    pub(super) fn sprite(size_metres: (f32, f32), px_per_metre: f32, colour: Colour) -> Self {
        Self { fourth: 255, ..Self::new(size_metres, px_per_metre, colour, 0) }
    }

    fn new(size_metres: (f32, f32), px_per_metre: f32, [r, g, b]: Colour, fourth: u8) -> Self {
        let width_px = ((size_metres.0 * px_per_metre).round() as usize).max(1);
        let height_px = ((size_metres.1 * px_per_metre).round() as usize).max(1);
        let texels = vec![[r, g, b, fourth]; width_px * height_px];
        Self { width_px, height_px, px_per_metre, fourth, texels }
    }

    pub(super) fn width_px(&self) -> usize {
        self.width_px
    }

    pub(super) fn height_px(&self) -> usize {
        self.height_px
    }

    pub(super) fn px_per_metre(&self) -> f32 {
        self.px_per_metre
    }

    /// The whole canvas.
    pub(super) fn area(&self) -> Area {
        let [width, height] = [self.width_px, self.height_px].map(|px| px as f32 / self.px_per_metre);
        Area::new(0.0, 0.0, width, height)
    }

    /// All texels, column by column, each from the bottom up.
    pub(super) fn into_texels(self) -> Vec<Texel> {
        self.texels
    }

    /// Calls `paint` with the position in metres of every texel in `area`.
    pub(super) fn edit(&mut self, area: Area, mut paint: impl FnMut(f32, f32, &mut Texel)) {
        let clamp =
            |metres: f32, size: usize| ((metres * self.px_per_metre).round().max(0.0) as usize).min(size);
        let columns = clamp(area.left, self.width_px)..clamp(area.right, self.width_px);
        let (low, high) = (clamp(area.bottom, self.height_px), clamp(area.top, self.height_px));
        let metre = 1.0 / self.px_per_metre;
        for x in columns {
            let column = &mut self.texels[x * self.height_px..(x + 1) * self.height_px];
            for (y, texel) in column.iter_mut().enumerate().take(high).skip(low) {
                paint((x as f32 + 0.5) * metre, (y as f32 + 0.5) * metre, texel);
            }
        }
    }

    /// Fills `area` with one colour.
    pub(super) fn fill(&mut self, area: Area, [r, g, b]: Colour) {
        let fourth = self.fourth;
        self.edit(area, |_, _, texel| *texel = [r, g, b, fourth]);
    }

    /// Fills `area` and lets it glow in the dark, from 0 to 255.
    pub(super) fn fill_glowing(&mut self, area: Area, [r, g, b]: Colour, glow: u8) {
        self.edit(area, |_, _, texel| *texel = [r, g, b, glow]);
    }

    /// Fills `area` with a run of colours from `bottom` to `top`.
    pub(super) fn gradient(&mut self, area: Area, bottom: Colour, top: Colour) {
        let fourth = self.fourth;
        self.edit(area, |_, z, texel| {
            let [r, g, b] = blend(bottom, top, ((z - area.bottom) / area.height()).clamp(0.0, 1.0));
            *texel = [r, g, b, fourth];
        });
    }

    /// Multiplies the colours in `area`.
    pub(super) fn shade(&mut self, area: Area, factor: f32) {
        self.edit(area, |_, _, texel| multiply(texel, factor));
    }

    /// Fills the ellipse inscribed in `area`.
    pub(super) fn ellipse(&mut self, area: Area, [r, g, b]: Colour) {
        let fourth = self.fourth;
        let (middle, centre) = (area.middle(), (area.bottom + area.top) / 2.0);
        self.edit(area, |x, z, texel| {
            let (dx, dz) = ((x - middle) / area.width(), (z - centre) / area.height());
            if dx * dx + dz * dz <= 0.25 {
                *texel = [r, g, b, fourth];
            }
        });
    }

    /// A border of `thickness` metres inside `area`.
    pub(super) fn border(&mut self, area: Area, thickness: f32, colour: Colour) {
        let Area { left, bottom, right, top } = area;
        self.fill(Area { right: left + thickness, ..area }, colour);
        self.fill(Area { left: right - thickness, ..area }, colour);
        self.fill(Area { top: bottom + thickness, ..area }, colour);
        self.fill(Area { bottom: top - thickness, ..area }, colour);
    }

    /// Lays surface grain over `area`; `strength` 0.1 changes brightness by about a tenth.
    pub(super) fn grain(&mut self, area: Area, grain: &Grain, strength: f32) {
        let density = self.px_per_metre;
        self.edit(area, |x, z, texel| {
            let value = grain.at((x * density) as usize, (z * density) as usize);
            multiply(texel, 1.0 + strength * value);
        });
    }

    /// Writes capital letters and digits as large as `area` allows, centred in it.
    pub(super) fn text(&mut self, area: Area, text: &str, colour: Colour) {
        let dot = (area.width() / lettering::width_dots(text)).min(area.height() / lettering::HEIGHT_DOTS);
        // Dots of whole texels keep letters legible.
        let dot = (dot * self.px_per_metre).floor().max(1.0) / self.px_per_metre;
        let left = area.middle() - dot * lettering::width_dots(text) / 2.0;
        let top = (area.bottom + area.top + dot * lettering::HEIGHT_DOTS) / 2.0;
        let snap = |metres: f32| (metres * self.px_per_metre).round() / self.px_per_metre;
        let (left, top) = (snap(left), snap(top));
        for (column, row) in lettering::dots(text) {
            let (x, z) = (left + column as f32 * dot, top - (row + 1) as f32 * dot);
            self.fill(Area::new(x, z, dot, dot), colour);
        }
    }
}

/// Multiplies the colour of a texel.
#[inline]
pub(super) fn multiply(texel: &mut Texel, factor: f32) {
    for channel in &mut texel[..3] {
        *channel = (f32::from(*channel) * factor).clamp(0.0, 255.0) as u8;
    }
}

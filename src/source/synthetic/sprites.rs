//! Sprites before the walls: passers-by, trees, lamps with their halos, plants.

use super::camera::View;
use super::light::mixed;
use super::plan::Vector;
use super::render::{Occlusion, Picture, Scene};
use super::texture::{Radiance, Texture};
use super::world::{Billboard, Lamp};

/// Sprites nearer or farther than this are not drawn, in metres.
const DEPTHS_METRES: std::ops::Range<f32> = 0.7..90.0;
/// Radius of the halo around a lit street lamp.
const HALO_METRES: f32 = 1.1;

/// A sprite as the camera sees it.
struct Seen<'a> {
    texture: &'a Texture,
    depth: f32,
    /// Screen column of its middle.
    middle_px: f32,
    light: Radiance,
}

/// Draws `billboards` from far to near, and the halos of street lamps at night.
pub(super) fn render_sprites(
    scene: Scene<'_>,
    view: &View,
    billboards: &[Billboard],
    (picture, occlusion): (&mut Picture, &[Occlusion]),
) {
    let mut seen: Vec<Seen<'_>> = billboards
        .iter()
        .filter_map(|billboard| {
            let (middle_px, depth) = project(view, billboard.at)?;
            let light = scene.illumination.around(scene.world, billboard.at);
            Some(Seen { texture: &scene.world.sprites[billboard.sprite], depth, middle_px, light })
        })
        .collect();
    seen.sort_by(|a, b| b.depth.total_cmp(&a.depth));
    let mut strip = Vec::new();
    for sprite in &seen {
        for x in columns(view, sprite.middle_px, sprite.texture.width_metres() / 2.0, sprite.depth) {
            let rows = open_rows(&occlusion[x], sprite.depth, view.size_px.1);
            paint_column(scene, view, sprite, (x, picture.column_mut(x), rows, &mut strip));
        }
    }
    if scene.world.ceiling.is_none() {
        for lamp in &scene.illumination.lamps {
            halo(scene, view, lamp, (picture, occlusion));
        }
    }
}

/// Screen column and depth of a point on the plan, if it can be seen.
fn project(view: &View, at: Vector) -> Option<(f32, f32)> {
    let forward = Vector::from_heading(view.heading_radians);
    let offset = at - view.eye;
    let (depth, right) = (offset.dot(forward), -offset.dot(forward.left()));
    let middle = view.size_px.0 as f32 / 2.0 + view.focal_px * right / depth;
    DEPTHS_METRES.contains(&depth).then_some((middle, depth))
}

/// Screen columns within `reach` metres of column `middle_px` at `depth`.
fn columns(view: &View, middle_px: f32, reach: f32, depth: f32) -> std::ops::Range<usize> {
    let reach_px = reach * view.focal_px / depth;
    let column = |x: f32| ((x - 0.5).ceil().max(0.0) as usize).min(view.size_px.0);
    column(middle_px - reach_px)..column(middle_px + reach_px)
}

/// How many rows from the top are open for something at `depth`.
fn open_rows(occlusion: &Occlusion, depth: f32, height: usize) -> usize {
    match () {
        () if depth > occlusion.tall_depth => 0,
        () if depth > occlusion.low_depth => occlusion.low_row,
        () => height,
    }
}

fn paint_column(
    scene: Scene<'_>,
    view: &View,
    sprite: &Seen<'_>,
    (x, column, open, strip): (usize, &mut [Radiance], usize, &mut Vec<Radiance>),
) {
    let metres_per_px = sprite.depth / view.focal_px;
    let texture = sprite.texture;
    let level = texture.level_for(metres_per_px);
    let across = (x as f32 + 0.5 - sprite.middle_px) * metres_per_px + texture.width_metres() / 2.0;
    strip.clear();
    texture.read_strip(level, (across, metres_per_px), 0..texture.height_px(level), strip);
    let lighting = &scene.illumination.lighting;
    let haze = lighting.haze_through(sprite.depth);
    let top = view.row(sprite.depth, texture.height_metres()).max(0.0) as usize;
    let base = view.row(sprite.depth, 0.0);
    let foot_shade = 1.0 - (2.0 * across / texture.width_metres() - 1.0).powi(2);
    shadow(column, base, foot_shade * 0.2 * view.eye_height / sprite.depth / metres_per_px, open);
    for (row, pixel) in column.iter_mut().enumerate().take((base.max(0.0) as usize).min(open)).skip(top) {
        let y = ((base - row as f32 - 0.5) * metres_per_px * texture.density(level) - 0.5)
            .clamp(0.0, (strip.len() - 1) as f32);
        let texel = mixed(strip[y as usize], strip[(y as usize + 1).min(strip.len() - 1)], y.fract());
        if texel[3] > 0.02 {
            let colour = lighting.shade([texel[0], texel[1], texel[2], 0.0], sprite.light);
            *pixel = mixed(*pixel, mixed(colour, haze.0, haze.1), texel[3]);
        }
    }
}

/// Darkens the ground around the foot of a sprite, `reach` rows up and down.
fn shadow(column: &mut [Radiance], base: f32, reach: f32, open: usize) {
    let first = (base - reach).max(0.0) as usize;
    let last = ((base + reach).max(0.0) as usize).min(open);
    for (row, pixel) in column.iter_mut().enumerate().take(last).skip(first) {
        let off = (row as f32 + 0.5 - base) / reach.max(0.5);
        let factor = 1.0 - 0.45 * (1.0 - off * off).max(0.0);
        *pixel = pixel.map(|channel| channel * factor);
    }
}

/// The glow of a lit lantern in the air.
fn halo(scene: Scene<'_>, view: &View, lamp: &Lamp, (picture, occlusion): (&mut Picture, &[Occlusion])) {
    let Some((middle_px, depth)) = project(view, lamp.at) else { return };
    let centre = view.row(depth, lamp.height - 0.08);
    let reach = HALO_METRES * view.focal_px / depth;
    let colour = scene.illumination.lighting.lamp_colour;
    for x in columns(view, middle_px, HALO_METRES, depth) {
        if depth > occlusion[x].tall_depth {
            continue;
        }
        let across = (x as f32 + 0.5 - middle_px) / reach;
        let (first, last) = ((centre - reach).max(0.0) as usize, (centre + reach).max(0.0) as usize);
        for (row, pixel) in picture.column_mut(x).iter_mut().enumerate().take(last).skip(first) {
            let down = (row as f32 + 0.5 - centre) / reach;
            let inside = (1.0 - across * across - down * down).max(0.0);
            let shine = 0.05 * inside * inside + 0.9 * inside.powi(24);
            (0..3).for_each(|c| pixel[c] += colour[c] * shine);
        }
    }
}

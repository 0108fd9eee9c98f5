//! A scene as PNG.

use std::collections::BTreeMap;

use ab_glyph::{Font, FontRef, PxScale, ScaleFont, point};
use ab_glyph_rasterizer::{Point, Rasterizer, point as corner};
use nix::errno::Errno;

use super::scene::{Anchor, SIZE, Scene, Shape};
use crate::error::{Error, Result};

/// The letters of plots; `LICENSE` says whose they are.
const LABELS: &[u8] = include_bytes!("labels.ttf");

fn failed(why: impl Into<String>) -> Error {
    Error::host("PNG", Errno::EINVAL, why)
}

/// Pixels, three bytes each.
struct Picture {
    width: usize,
    height: usize,
    bytes: Vec<u8>,
}

/// All of it.
pub(super) fn render(scene: &Scene) -> Result<Vec<u8>> {
    let font = FontRef::try_from_slice(LABELS).map_err(|error| failed(error.to_string()))?;
    let (width, height) = (scene.width as usize, scene.height as usize);
    let mut picture = Picture { width, height, bytes: vec![0xff; 3 * width * height] };
    for shape in &scene.shapes {
        match shape {
            Shape::Line { points, colour, width } => line(&mut picture, points, *colour, *width),
            Shape::Dot { at, colour, radius } => picture.fill(&[disc(*at, *radius)], *colour),
            Shape::Text { at, text, colour, anchor, bold } => {
                write(&mut picture, &font, *at, text, *colour, *anchor);
                // The font has one weight: a letter that is struck twice is bold.
                if *bold {
                    write(&mut picture, &font, (at.0 + 0.6, at.1), text, *colour, *anchor);
                }
            }
        }
    }
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    let written = encoder.write_header().and_then(|mut writer| writer.write_image_data(&picture.bytes));
    written.map_err(|error| failed(error.to_string()))?;
    Ok(file)
}

/// A stroke is what its pieces and the discs at its joints cover.
fn line(picture: &mut Picture, points: &[(f64, f64)], colour: [u8; 3], width: f64) {
    let half = width / 2.0;
    let mut pieces = Vec::new();
    for pair in points.windows(2) {
        let [(x, y), (to_x, to_y)] = [pair[0], pair[1]];
        let length = (to_x - x).hypot(to_y - y);
        if length == 0.0 {
            continue;
        }
        let (across, along) = ((to_x - x) / length * half, (to_y - y) / length * half);
        let at = |x: f64, y: f64| corner(x as f32, y as f32);
        pieces.push(vec![
            at(x + along, y - across),
            at(to_x + along, to_y - across),
            at(to_x - along, to_y + across),
            at(x - along, y + across),
        ]);
    }
    let joints = points.iter().skip(1).take(points.len().saturating_sub(2));
    pieces.extend(joints.map(|&at| disc(at, half)));
    picture.fill(&pieces, colour);
}

/// A circle, as far as pixels can tell.
fn disc((x, y): (f64, f64), radius: f64) -> Vec<Point> {
    let turn = |at: u8| f64::from(at) / 12.0 * std::f64::consts::TAU;
    let place = |at: u8| (x + radius * turn(at).cos(), y + radius * turn(at).sin());
    (0..12).map(place).map(|(x, y)| corner(x as f32, y as f32)).collect()
}

impl Picture {
    /// Fills polygons as one shape: where two of them meet no pixel gets darker.
    fn fill(&mut self, polygons: &[Vec<Point>], colour: [u8; 3]) {
        let mut cover: BTreeMap<(i64, i64), f32> = BTreeMap::new();
        for polygon in polygons {
            let least = |of: fn(&Point) -> f32| polygon.iter().map(of).fold(f32::INFINITY, f32::min).floor();
            let most =
                |of: fn(&Point) -> f32| polygon.iter().map(of).fold(f32::NEG_INFINITY, f32::max).ceil();
            let (left, top) = (least(|at| at.x), least(|at| at.y));
            let (width, height) = (most(|at| at.x) - left, most(|at| at.y) - top);
            let mut one = Rasterizer::new(width as usize + 1, height as usize + 1);
            let moved = |at: Point| corner(at.x - left, at.y - top);
            for (at, from) in polygon.iter().enumerate() {
                one.draw_line(moved(*from), moved(polygon[(at + 1) % polygon.len()]));
            }
            one.for_each_pixel_2d(|x, y, covered| {
                if covered > 0.0 {
                    let most =
                        cover.entry((left as i64 + i64::from(x), top as i64 + i64::from(y))).or_default();
                    *most = most.max(covered);
                }
            });
        }
        for ((x, y), cover) in cover {
            self.blend(x, y, colour, cover);
        }
    }

    fn blend(&mut self, x: i64, y: i64, colour: [u8; 3], cover: f32) {
        let (width, height) = (self.width as i64, self.height as i64);
        if !(0..width).contains(&x) || !(0..height).contains(&y) {
            return;
        }
        let at = 3 * (y * width + x) as usize;
        let cover = cover.clamp(0.0, 1.0);
        for (below, ink) in self.bytes[at..at + 3].iter_mut().zip(colour) {
            *below = (f32::from(*below) + (f32::from(ink) - f32::from(*below)) * cover).round() as u8;
        }
    }
}

fn write(
    picture: &mut Picture,
    font: &FontRef<'_>,
    at: (f64, f64),
    text: &str,
    colour: [u8; 3],
    anchor: Anchor,
) {
    // ab_glyph counts from the ascender to the descender, SVG the em square.
    let em = font.units_per_em().unwrap_or(1000.0);
    let scale = PxScale::from(SIZE as f32 * font.height_unscaled() / em);
    let font = font.as_scaled(scale);
    let length: f32 = text.chars().map(|letter| font.h_advance(font.glyph_id(letter))).sum();
    let mut x = at.0 as f32
        - match anchor {
            Anchor::Start => 0.0,
            Anchor::Middle => length / 2.0,
            Anchor::End => length,
        };
    for letter in text.chars() {
        let id = font.glyph_id(letter);
        let outline = font.outline_glyph(id.with_scale_and_position(scale, point(x, at.1 as f32)));
        x += font.h_advance(id);
        let Some(outline) = outline else { continue };
        let edge = outline.px_bounds().min;
        outline.draw(|column, row, cover| {
            let (x, y) = (edge.x as i64 + i64::from(column), edge.y as i64 + i64::from(row));
            picture.blend(x, y, colour, cover);
        });
    }
}

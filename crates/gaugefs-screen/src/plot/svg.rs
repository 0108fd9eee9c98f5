// SPDX-License-Identifier: MIT

//! A scene as SVG.

use std::fmt::Write;

use super::scene::{Anchor, SIZE, Scene, Shape, Style};

/// Renders a scene. Writing to a String does not fail.
pub(super) fn render(scene: &Scene) -> String {
    let (width, height) = (scene.width, scene.height);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
         height=\"{height}\" font-family=\"'DejaVu Sans', Verdana, sans-serif\" font-size=\"{SIZE}\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n"
    );
    for shape in &scene.shapes {
        let _ = match shape {
            Shape::Area { from: (x, y), to: (right, bottom), colour } => {
                let (width, height) = (right - x, bottom - y);
                writeln!(
                    svg,
                    "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"{}\"/>",
                    hex(*colour)
                )
            }
            Shape::Line { points, colour, width, dashed } => {
                let dashes = if *dashed { " stroke-dasharray=\"5 4\"" } else { "" };
                let points: Vec<_> = points.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
                writeln!(
                    svg,
                    "<polyline points=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{width}\" \
                     stroke-linejoin=\"round\"{dashes}/>",
                    points.join(" "),
                    hex(*colour)
                )
            }
            Shape::Dot { at: (x, y), colour, radius } => {
                writeln!(
                    svg,
                    "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\" fill=\"{}\"/>",
                    hex(*colour)
                )
            }
            Shape::Text { at: (x, y), text, colour, anchor, style } => {
                let anchor = match anchor {
                    Anchor::Start => "",
                    Anchor::Middle => " text-anchor=\"middle\"",
                    Anchor::End => " text-anchor=\"end\"",
                };
                let style = match style {
                    Style::Plain => "",
                    Style::Bold => " font-weight=\"bold\"",
                    Style::Title => " font-weight=\"bold\" font-size=\"16\"",
                };
                // Names come from the file. A control character would make the picture invalid.
                let text: String = text.chars().filter(|letter| !letter.is_control()).collect();
                let text = text.replace('&', "&amp;").replace('<', "&lt;");
                writeln!(
                    svg,
                    "<text x=\"{x:.1}\" y=\"{y:.1}\" fill=\"{}\"{anchor}{style}>{text}</text>",
                    hex(*colour)
                )
            }
        };
    }
    svg + "</svg>\n"
}

fn hex([red, green, blue]: [u8; 3]) -> String {
    format!("#{red:02x}{green:02x}{blue:02x}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_is_text_whatever_is_in_it() {
        let text = "a<b>&amp;\"c\"\n</text><script>\u{1b}\0".to_string();
        let shape =
            Shape::Text { at: (1.0, 2.0), text, colour: [0; 3], anchor: Anchor::Start, style: Style::Plain };
        let svg = render(&Scene { width: 10.0, height: 10.0, shapes: vec![shape] });
        assert!(svg.contains(">a&lt;b>&amp;amp;\"c\"&lt;/text>&lt;script></text>\n"), "{svg}");
        assert!(!svg.contains(|letter: char| letter.is_control() && letter != '\n'), "{svg:?}");
    }
}

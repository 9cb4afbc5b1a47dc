//! A scene as SVG.

use std::fmt::Write;

use maud::{PreEscaped, html};

use crate::plot::canvas::{AREA, DASH, PlotColor, PlotScene, SceneShape, TextAnchor};

/// How far the middle of a small letter is above the line it stands on, as a part of its size.
pub(super) const MIDDLE: f64 = 0.36;

pub(super) fn svg(scene: &PlotScene) -> String {
    let (width, height) = (scene.width, scene.height);
    let shapes = html! { @for shape in &scene.shapes { (PreEscaped(element(shape))) "\n" } };
    let head = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" \
         font-family=\"'DejaVu Sans', Verdana, sans-serif\">\n<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n"
    );
    format!("{head}{}</svg>\n", shapes.into_string())
}

fn element(shape: &SceneShape) -> String {
    match shape {
        SceneShape::Line { points, color, width, dashed } => {
            let dashes = if *dashed { format!(" stroke-dasharray=\"{DASH}\"") } else { String::new() };
            let (points, color) = (list(points), hex(*color));
            format!("<polyline points=\"{points}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"{width}\"{dashes}/>")
        }
        SceneShape::Area { points, color } => {
            format!("<polygon points=\"{}\" fill=\"{}\" fill-opacity=\"{AREA}\"/>", list(points), hex(*color))
        }
        SceneShape::Bar { from: [x, y], to: [right, bottom], color } => format!(
            "<rect x=\"{x:.2}\" y=\"{y:.2}\" width=\"{:.2}\" height=\"{:.2}\" fill=\"{}\"/>",
            (right - x).max(0.0),
            (bottom - y).max(0.0),
            hex(*color)
        ),
        SceneShape::Dot { at: [x, y], radius, color, filled } => {
            let fill = if *filled { hex(*color) } else { "#ffffff".to_owned() };
            let color = hex(*color);
            format!(
                "<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"{radius}\" fill=\"{fill}\" stroke=\"{color}\" stroke-width=\"1\"/>"
            )
        }
        SceneShape::Text { at: [x, y], words, size, side, color } => {
            let anchor = match side {
                TextAnchor::Left => "start",
                TextAnchor::Middle => "middle",
                TextAnchor::Right => "end",
            };
            let (line, color, words) = (y + MIDDLE * size, hex(*color), html! { (words) }.into_string());
            format!(
                "<text x=\"{x:.2}\" y=\"{line:.2}\" font-size=\"{size}\" text-anchor=\"{anchor}\" fill=\"{color}\">{words}</text>"
            )
        }
    }
}

fn hex([red, green, blue]: PlotColor) -> String {
    format!("#{red:02x}{green:02x}{blue:02x}")
}

fn list(points: &[[f64; 2]]) -> String {
    let mut text = String::new();
    for [x, y] in points {
        let space = if text.is_empty() { "" } else { " " };
        write!(text, "{space}{x:.2},{y:.2}").expect("a text takes all");
    }
    text
}

//! A map: one coloured cell for each pair of an x and a y value.

use crate::drawing::{Anchor, BLACK, Colour, Drawing, text_px, wrapped};

/// Room for the names of the rows at least, px, and beside them for the y axis's own.
const LEFT: f64 = 84.0;
const LABEL: f64 = 30.0;
/// Height of what stands above and below the cells, px.
const ABOVE: f64 = 20.0;
const BELOW: f64 = 56.0;
/// Height of a further line of text, px.
const LINE: f64 = 13.0;
/// Largest share of a given width that the names of the rows take.
const NAMES: f64 = 0.42;

/// Cells with their colours, a line between those on different sides, and what the colours mean.
#[derive(Clone, Debug)]
pub struct Map {
    /// Above it.
    pub title: String,
    /// With its unit.
    pub x_label: String,
    /// With its unit.
    pub y_label: String,
    /// Names of the columns.
    pub x: Vec<String>,
    /// Names of the rows, the lowest first.
    pub y: Vec<String>,
    /// Row by row from the first y: colour and a short text.
    pub cells: Vec<(Colour, String)>,
    /// Which side of a line each cell is on; the line is drawn between cells that differ.
    pub sides: Vec<bool>,
    /// Meaning of each colour.
    pub legend: Vec<(Colour, &'static str)>,
    /// Width of the whole map, px: its texts are wrapped to fit. `None`: as wide as its cells, every text on one line.
    pub fit_px: Option<f64>,
}

impl Map {
    /// Height of the whole map with cells of `cell` pixels, px.
    pub fn height(&self, cell: [f64; 2]) -> f64 {
        let more = self.title_lines().len() + self.legend_places().last().map_or(0, |(_, line)| *line);
        let extra = LINE * count(more.saturating_sub(1));
        ABOVE + self.cell(cell)[1] * count(self.y.len()) + BELOW + extra
    }

    /// Width of the names and of the cells, px.
    pub fn width(&self, cell_width: f64) -> f64 {
        self.fit_px.unwrap_or_else(|| self.left() + cell_width * count(self.x.len()))
    }

    /// Size of a cell that is wanted to be `wanted` pixels: a given width decides the width, the texts the least height.
    fn cell(&self, wanted: [f64; 2]) -> [f64; 2] {
        let Some(fit_px) = self.fit_px else { return wanted };
        let width = (fit_px - self.left()).max(0.0) / count(self.x.len().max(1));
        let cells = self.cells.iter().map(|(_, text)| broken(text, width).len());
        let names = self.y.iter().map(|name| self.name_lines(name).len());
        let lines = cells.chain(names).max().unwrap_or(1);
        [width, wanted[1].max(LINE * count(lines) + 6.0)]
    }

    fn left(&self) -> f64 {
        let longest = self.y.iter().map(|name| name.chars().count()).max().unwrap_or(0);
        let room = LABEL + text_px(longest);
        self.fit_px.map_or(LEFT.max(room), |fit_px| room.min(NAMES * fit_px))
    }

    fn name_lines(&self, name: &str) -> Vec<String> {
        if self.fit_px.is_none() { vec![name.to_owned()] } else { broken(name, self.left() - LABEL) }
    }

    fn title_lines(&self) -> Vec<String> {
        self.fit_px.map_or_else(|| vec![self.title.clone()], |fit_px| wrapped(&self.title, fit_px - 4.0))
    }

    /// Left end of each colour's meaning, px from the first, and its line.
    fn legend_places(&self) -> Vec<(f64, usize)> {
        let (mut x, mut line, mut places) = (0.0, 0, Vec::new());
        for (_, meaning) in &self.legend {
            let room = 34.0 + 6.2 * count(meaning.chars().count());
            if x > 0.0 && self.fit_px.is_some_and(|fit_px| x + room > fit_px) {
                (x, line) = (0.0, line + 1);
            }
            places.push((x, line));
            x += room;
        }
        places
    }

    /// Draws it with cells of `cell` pixels.
    pub fn draw(&self, drawing: &mut Drawing, [left, top]: [f64; 2], cell: [f64; 2]) {
        let cell = self.cell(cell);
        let x0 = left + self.left();
        // A title and a legend that are wrapped use the whole width.
        let edge = if self.fit_px.is_some() { left + 2.0 } else { x0 };
        let title = self.title_lines();
        for (i, line) in title.iter().enumerate() {
            drawing.text([edge, top + 12.0 + LINE * count(i)], Anchor::Start, line, BLACK);
        }
        let top = top + LINE * count(title.len().saturating_sub(1));
        let height = cell[1] * count(self.y.len());
        let bottom = top + ABOVE + height;
        drawing.text_upwards([left + 12.0, bottom - 0.5 * height], &self.y_label, BLACK);
        for (row, name) in self.y.iter().enumerate() {
            let y = bottom - cell[1] * (count(row) + 1.0);
            lines(drawing, [x0 - 8.0, y + 0.5 * cell[1]], Anchor::End, &self.name_lines(name));
            let cells = self.cells.iter().skip(row * self.x.len()).take(self.x.len());
            for (column, (colour, text)) in cells.enumerate() {
                let x = x0 + cell[0] * count(column);
                drawing.rectangle([x, y], [cell[0] - 1.0, cell[1] - 1.0], *colour);
                let text = if self.fit_px.is_some() { broken(text, cell[0]) } else { vec![text.clone()] };
                lines(drawing, [x + 0.5 * cell[0], y + 0.5 * cell[1]], Anchor::Middle, &text);
            }
        }
        for (column, name) in self.x.iter().enumerate() {
            let x = x0 + cell[0] * (count(column) + 0.5);
            drawing.text([x, bottom + 14.0], Anchor::Middle, name, BLACK);
        }
        let middle = x0 + 0.5 * cell[0] * count(self.x.len());
        drawing.text([middle, bottom + 29.0], Anchor::Middle, &self.x_label, BLACK);
        for ((colour, meaning), (x, line)) in self.legend.iter().zip(self.legend_places()) {
            let (x, y) = (edge + x, bottom + LINE * count(line));
            drawing.rectangle([x, y + 37.0], [11.0, 11.0], *colour);
            drawing.text([x + 15.0, y + 47.0], Anchor::Start, meaning, BLACK);
        }
        self.border(drawing, [x0, bottom], cell);
    }

    /// The line between cells on different sides.
    fn border(&self, drawing: &mut Drawing, [x0, bottom]: [f64; 2], cell: [f64; 2]) {
        let side = |row: usize, column: usize| {
            (row < self.y.len() && column < self.x.len())
                .then(|| self.sides.get(row * self.x.len() + column))
                .flatten()
        };
        let differ = |a: Option<&bool>, b: Option<&bool>| a.zip(b).is_some_and(|(a, b)| a != b);
        for row in 0..self.y.len() {
            for column in 0..self.x.len() {
                let [left, bottom] =
                    [x0 + cell[0] * count(column) - 0.5, bottom - cell[1] * count(row) - 0.5];
                let [right, top] = [left + cell[0], bottom - cell[1]];
                if differ(side(row, column), side(row, column + 1)) {
                    drawing.line(&[[right, bottom], [right, top]], 3.0, BLACK);
                }
                if differ(side(row, column), side(row + 1, column)) {
                    drawing.line(&[[left, top], [right, top]], 3.0, BLACK);
                }
            }
        }
    }
}

/// Splits a text at its blanks, and after the dash of a range, into lines that are at most `width` wide, px.
fn broken(text: &str, width: f64) -> Vec<String> {
    let lines = wrapped(text, width).into_iter();
    let halves = lines.flat_map(|line| match line.split_once('–') {
        Some((from, to)) if !to.is_empty() && text_px(line.chars().count()) > width => {
            vec![format!("{from}–"), to.to_owned()]
        }
        _ => vec![line],
    });
    halves.collect()
}

/// Writes lines of text below each other, with their middle at a place.
fn lines(drawing: &mut Drawing, [x, middle]: [f64; 2], anchor: Anchor, text: &[String]) {
    let first = middle + 4.0 - 0.5 * LINE * count(text.len().saturating_sub(1));
    for (i, line) in text.iter().enumerate() {
        drawing.text([x, first + LINE * count(i)], anchor, line, BLACK);
    }
}

fn count(value: usize) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "a few cells")]
    let value = value as f64;
    value
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_stand_at_their_values_and_line_between_sides() {
        let map = Map {
            title: "t".into(),
            x_label: "x".into(),
            y_label: "y".into(),
            x: vec!["1".into(), "2".into()],
            y: vec!["a".into(), "b".into()],
            cells: ["1a", "2a", "1b", "2b"].map(|text| ([200; 3], text.to_owned())).to_vec(),
            sides: vec![true, false, true, false],
            legend: vec![([200; 3], "all the same")],
            fit_px: None,
        };
        let mut drawing = Drawing::new(300.0, map.height([60.0, 30.0]));
        map.draw(&mut drawing, [0.0, 0.0], [60.0, 30.0]);
        let svg = drawing.svg();
        // Rows count upwards: the first y is the lower one.
        assert!(svg.find(">1a<") < svg.find(">1b<"));
        assert_eq!(svg.matches("stroke-width=\"3\"").count(), 2);
    }
    #[test]
    fn narrow_map_wraps_texts_and_keeps_its_width() {
        let map = Map {
            title: "a title that is much too long for a column of a journal".into(),
            x_label: "x".into(),
            y_label: "y".into(),
            x: vec!["1".into(), "2".into()],
            y: vec!["leg of 50 N/mm, 3 m/s²".into(), "rigid, 3 m/s²".into()],
            cells: vec![([200; 3], "0.123 of 0.240–0.250".to_owned()); 4],
            sides: vec![true; 4],
            legend: vec![([200; 3], "a meaning of a colour"), ([100; 3], "another meaning")],
            fit_px: Some(200.0),
        };
        assert!((map.width(136.0) - 200.0).abs() < 1e-9);
        let mut drawing = Drawing::new(200.0, map.height([136.0, 22.0]));
        map.draw(&mut drawing, [0.0; 2], [136.0, 22.0]);
        for text in drawing.texts() {
            assert!(text_px(text.chars().count()) <= 200.0, "{text}");
        }
        let texts: Vec<&str> = drawing.texts().collect();
        assert!(texts.contains(&"0.240–") && texts.contains(&"0.123 of"), "{texts:?}");
    }
}

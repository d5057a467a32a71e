//! A map: one coloured cell for each pair of an x and a y value.

use crate::drawing::{Anchor, BLACK, Colour, Drawing, text_px};

/// Room for the names of the rows at least, px, and beside them for the y axis's own.
const LEFT: f64 = 84.0;
const LABEL: f64 = 30.0;
/// Height of what stands above and below the cells, px.
const ABOVE: f64 = 20.0;
const BELOW: f64 = 56.0;

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
}

impl Map {
    /// Height of the whole map with cells of this height, px.
    pub fn height(&self, cell_height: f64) -> f64 {
        ABOVE + cell_height * count(self.y.len()) + BELOW
    }

    /// Width of the names and of the cells, px.
    pub fn width(&self, cell_width: f64) -> f64 {
        self.left() + cell_width * count(self.x.len())
    }

    fn left(&self) -> f64 {
        let longest = self.y.iter().map(|name| name.chars().count()).max().unwrap_or(0);
        LEFT.max(LABEL + text_px(longest))
    }

    /// Draws it with cells of `cell` pixels.
    pub fn draw(&self, drawing: &mut Drawing, [left, top]: [f64; 2], cell: [f64; 2]) {
        let x0 = left + self.left();
        let height = cell[1] * count(self.y.len());
        let bottom = top + ABOVE + height;
        drawing.text([x0, top + 12.0], Anchor::Start, &self.title, BLACK);
        drawing.text_upwards([left + 12.0, bottom - 0.5 * height], &self.y_label, BLACK);
        for (row, name) in self.y.iter().enumerate() {
            let y = bottom - cell[1] * (count(row) + 1.0);
            drawing.text([x0 - 8.0, y + 0.5 * cell[1] + 4.0], Anchor::End, name, BLACK);
            let cells = self.cells.iter().skip(row * self.x.len()).take(self.x.len());
            for (column, (colour, text)) in cells.enumerate() {
                let x = x0 + cell[0] * count(column);
                drawing.rectangle([x, y], [cell[0] - 1.0, cell[1] - 1.0], *colour);
                drawing.text([x + 0.5 * cell[0], y + 0.5 * cell[1] + 4.0], Anchor::Middle, text, BLACK);
            }
        }
        for (column, name) in self.x.iter().enumerate() {
            let x = x0 + cell[0] * (count(column) + 0.5);
            drawing.text([x, bottom + 14.0], Anchor::Middle, name, BLACK);
        }
        let middle = x0 + 0.5 * cell[0] * count(self.x.len());
        drawing.text([middle, bottom + 29.0], Anchor::Middle, &self.x_label, BLACK);
        let mut x = x0;
        for (colour, meaning) in &self.legend {
            drawing.rectangle([x, bottom + 37.0], [11.0, 11.0], *colour);
            drawing.text([x + 15.0, bottom + 47.0], Anchor::Start, meaning, BLACK);
            x += 34.0 + 6.2 * count(meaning.chars().count());
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
        };
        let mut drawing = Drawing::new(300.0, map.height(30.0));
        map.draw(&mut drawing, [0.0, 0.0], [60.0, 30.0]);
        let svg = drawing.svg();
        // Rows count upwards: the first y is the lower one.
        assert!(svg.find(">1a<") < svg.find(">1b<"));
        assert_eq!(svg.matches("stroke-width=\"3\"").count(), 2);
    }
}

// SPDX-License-Identifier: MIT

//! Reduces a line to the points that a picture can show.

pub(super) type Point = (f64, f64);

/// Keeps at most three points per column: the smallest, the largest and the last, so that no peak is lost.
pub(super) fn thin(line: &[Point], from: f64, span: f64, columns: usize) -> Vec<Point> {
    let mut thinned = Vec::new();
    let mut column: Option<Column> = None;
    for &point in line {
        let number = ((point.0 - from) / span * columns as f64).floor() as i64;
        match &mut column {
            Some(column) if column.number == number => column.take(point),
            _ => {
                let ended = column.replace(Column { number, least: point, most: point, last: point });
                ended.into_iter().for_each(|column| column.end(&mut thinned));
            }
        }
    }
    column.into_iter().for_each(|column| column.end(&mut thinned));
    thinned
}

struct Column {
    number: i64,
    least: Point,
    most: Point,
    last: Point,
}

impl Column {
    fn take(&mut self, point: Point) {
        if point.1 < self.least.1 {
            self.least = point;
        }
        if point.1 > self.most.1 {
            self.most = point;
        }
        self.last = point;
    }

    fn end(self, line: &mut Vec<Point>) {
        let mut points = [self.least, self.most, self.last];
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        line.extend(points);
        line.dedup();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dense_line_keeps_its_peaks() {
        let line: Vec<_> =
            (0..10_000).map(|at| (f64::from(at), if at == 5000 { 9.0 } else { f64::from(at % 2) })).collect();
        let thinned = thin(&line, 0.0, 10_000.0, 100);
        assert!(thinned.len() <= 300, "{}", thinned.len());
        assert!(thinned.contains(&(5000.0, 9.0)));
        assert_eq!((thinned[0], thinned[thinned.len() - 1]), (line[0], line[9999]));
        assert!(thinned.is_sorted_by(|a, b| a.0 < b.0));
    }

    #[test]
    fn a_sparse_line_is_unchanged() {
        let line = [(0.0, 1.0), (3.0, 2.0), (7.0, 1.5)];
        assert_eq!(thin(&line, 0.0, 10.0, 100), line);
    }
}

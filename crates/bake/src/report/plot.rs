//! Curves as SVG.

use plotters::coord::Shift;
use plotters::coord::combinators::LogCoord;
use plotters::prelude::*;

/// A named curve: points of x and y. Those not above zero are not drawn.
pub struct Curve {
    /// As the legend has it.
    pub name: String,
    /// In the order in which they are joined.
    pub points: Vec<[f64; 2]>,
}

/// Curves over logarithmic axes as SVG; `None` where no point is above zero.
pub fn svg(title: &str, axes: [&str; 2], curves: &[Curve]) -> Option<String> {
    let range = |axis: usize| {
        let values = curves.iter().flat_map(|curve| &curve.points);
        let (low, high) = values
            .map(|point| point[axis])
            .filter(|value| *value > 0.0)
            .fold((f64::INFINITY, 0.0f64), |(low, high), value| {
                (low.min(value), high.max(value))
            });
        (low < f64::INFINITY)
            .then(|| -> LogCoord<f64> { (0.8 * low..1.25 * high).log_scale().into() })
    };
    let (x, y) = (range(0)?, range(1)?);
    let mut text = String::new();
    {
        let area = SVGBackend::with_string(&mut text, (900, 560)).into_drawing_area();
        draw(&area, title, axes, curves, x, y).ok()?;
    }
    Some(text)
}

fn draw<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    title: &str,
    axes: [&str; 2],
    curves: &[Curve],
    x: LogCoord<f64>,
    y: LogCoord<f64>,
) -> Result<(), DrawingAreaErrorKind<B::ErrorType>> {
    area.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 18))
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(64)
        .build_cartesian_2d(x, y)?;
    chart
        .configure_mesh()
        .x_desc(axes[0])
        .y_desc(axes[1])
        .light_line_style(BLACK.mix(0.06))
        .draw()?;
    for (index, curve) in curves.iter().enumerate() {
        let color = Palette99::pick(index).to_rgba();
        let positive = |point: &&[f64; 2]| point.iter().all(|value| *value > 0.0);
        let points = || (curve.points.iter()).filter(positive).map(|&[x, y]| (x, y));
        chart
            .draw_series(LineSeries::new(points(), color.stroke_width(2)))?
            .label(curve.name.as_str())
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], color.stroke_width(2)));
        chart.draw_series(points().map(|point| Circle::new(point, 3, color.filled())))?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.3))
        .draw()?;
    area.present()
}

//! Figures as files: what is in them, and that any record ends in one or in a reason.

use crate::common;

use kalfit::FitRecord;
use kalfit::record::TestRecords;
use kalfit_report::{PlotError, PlotFormat, PlotKind, WIDTHS, plot};

fn svg(record: &FitRecord, what: PlotKind, width: u32) -> Result<String, PlotError> {
    let bytes = plot(record, what, (None, None), (PlotFormat::Svg, width))?;
    Ok(String::from_utf8(bytes).expect("SVG is text"))
}

/// Numbers of an attribute of all elements of a kind.
fn numbers(figure: &str, element: &str, attribute: &str) -> Vec<f64> {
    let of = |text: &str| format!(" {text}").split(&format!(" {attribute}=\"")).nth(1)?.split('"').next()?.parse().ok();
    figure.split(&format!("<{element} ")).skip(1).filter_map(of).collect()
}

#[test]
fn places_are_in_proportion_to_values() {
    let mut record = common::sleepstudy();
    let mean = &mut record.phases[0].mean;
    (mean.estimate, mean.interval95) = (vec![1.0, 2.0], vec![Some([Some(0.0), Some(4.0)]), None]);
    record.phases[0].units = vec![None, None];
    let figure = svg(&record, PlotKind::Forest, 800).expect("a figure");
    let at = numbers(&figure, "circle", "cx");
    let tick = |words: &str| {
        let text = figure.split("<text ").find(|text| text.contains(&format!(">{words}<"))).expect("a tick");
        numbers(&format!("<text {text}"), "text", "x")[0]
    };
    let (zero, four) = (tick("0"), tick("4"));
    for (value, found) in [(1.0, at[0]), (2.0, at[1])] {
        let expected = zero + value / 4.0 * (four - zero);
        assert!((found - expected).abs() < 0.02, "{value} is at {found}, expected at {expected}");
    }
}

#[test]
fn nothing_is_drawn_outside_at_any_width() {
    for width in [*WIDTHS.start(), 500, *WIDTHS.end()] {
        for what in [PlotKind::Forest, PlotKind::Ellipses] {
            let figure = svg(&common::sleepstudy(), what, width).expect("a figure");
            let all = numbers(&figure, "circle", "cx").into_iter().chain(numbers(&figure, "text", "x"));
            let beyond: Vec<f64> = all.filter(|x| !(0.0..=f64::from(width)).contains(x)).collect();
            assert!(beyond.is_empty(), "{what:?} of {width} points has {beyond:?}");
        }
    }
}

#[test]
fn what_a_record_lacks_is_said() {
    let mut bare = common::record("Known start", vec![common::phase("main", &[])]);
    bare.tests = TestRecords::default();
    let of_data = [PlotKind::Records, PlotKind::Residuals, PlotKind::Quantiles, PlotKind::Allan];
    let of_results =
        [PlotKind::Forest, PlotKind::Ellipses, PlotKind::Influence, PlotKind::Tests, PlotKind::Sensitivities];
    assert!(of_data.iter().all(|what| what.is_of_data()) && !of_results.iter().any(|what| what.is_of_data()));
    for what in of_data.into_iter().chain(of_results) {
        let error = svg(&bare, what, 800).expect_err("there is nothing to draw");
        assert!(matches!(error, PlotError::Nothing(_)), "{what:?}: {error}");
    }
}

#[test]
fn figures_that_are_no_numbers_do_no_harm() {
    let mut record = common::singular();
    record.phases[0].mean.estimate[0] = f64::NAN;
    record.phases[0].std_dev.estimate[1] = f64::INFINITY;
    record.phases[0].mean.interval95 = vec![Some([Some(f64::NEG_INFINITY), Some(1e308)]); 3];
    record.phases[0].covariance.estimate[0][0] = 1e300;
    for format in [PlotFormat::Svg, PlotFormat::Png, PlotFormat::Pdf] {
        for what in [PlotKind::Forest, PlotKind::Ellipses] {
            let made = plot(&record, what, (None, None), (format, 400)).unwrap_or_default();
            let text = String::from_utf8_lossy(&made);
            assert!(format != PlotFormat::Svg || !(text.contains("NaN") || text.contains("inf")), "{text}");
        }
    }
}

#[test]
fn a_pdf_has_its_words_as_text() {
    let made = plot(&common::singular(), PlotKind::Forest, (None, None), (PlotFormat::Pdf, 800)).expect("a figure");
    let text = String::from_utf8_lossy(&made);
    assert!(text.starts_with("%PDF-1.7") && text.trim_end().ends_with("%%EOF"));
    // the table of letters: each glyph with its character
    let map = text.split("beginbfchar").nth(1).expect("letters").split("endbfchar").next().expect("an end");
    for letter in "m\u{b1}9".chars() {
        assert!(map.contains(&format!("<{:04X}>", u32::from(letter))), "{letter}: {map}");
    }
    let again = plot(&common::singular(), PlotKind::Forest, (None, None), (PlotFormat::Pdf, 800)).expect("a figure");
    assert!(made == again, "the same bytes every time");
}

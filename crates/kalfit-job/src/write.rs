//! fit.json: the tests are most of it, and are put into words by many threads.

use std::io::Write;
use std::ops::Range;
use std::path::Path;

use kalfit::FitRecord;
use kalfit::record::TestRecords;
use rayon::prelude::*;

use crate::json;
use crate::output::{OutputError, OutputFile};

/// Tests that one thread puts into words at a time.
const CHUNK: usize = 32;
/// Tests whose words are in memory at the same time, and those that are being put into words.
const ROUND: usize = 64 * CHUNK;

/// The tests of a record that has none, where they stand.
const NO_TESTS: &[u8] = b"\n  \"tests\": []";

/// Writes a record to a file, whole or not at all.
///
/// # Errors
/// The file cannot be written.
pub fn save(record: &mut FitRecord, path: &Path) -> Result<(), OutputError> {
    self::record(&OutputFile::prepare(path, &[])?, record)
}

/// Writes a text to a file, whole or not at all.
///
/// # Errors
/// The file cannot be written.
pub fn save_text(text: &str, path: &Path) -> Result<(), OutputError> {
    OutputFile::prepare(path, &[])?.write_bytes(text.as_bytes())
}

/// Writes a record, byte for byte as it would be written in one piece.
pub(crate) fn record(output: &OutputFile, record: &mut FitRecord) -> Result<(), OutputError> {
    let tests = std::mem::take(&mut record.tests);
    let head = json::to_vec(record);
    record.tests = tests;
    output.write_by(|mut file| {
        let head = head?;
        // line ends in texts are escaped, so that this stands but once at the start of a line
        let at = head.windows(NO_TESTS.len()).position(|bytes| bytes == NO_TESTS).expect("a record has its tests");
        let (before, after) = head.split_at(at + NO_TESTS.len() - 1);
        file.write_all(before)?;
        write_tests(&record.tests, file)?;
        file.write_all(after)?;
        file.write_all(b"\n")
    })
}

/// The elements of the list of tests. While some are written, the next ones are put into words.
fn write_tests(tests: &TestRecords, mut file: impl Write) -> std::io::Result<()> {
    let round = |first: usize| -> Vec<serde_json::Result<Vec<u8>>> {
        let starts = (first..tests.len().min(first + ROUND)).into_par_iter().step_by(CHUNK);
        starts.map(|start| words(tests, start..tests.len().min(start + CHUNK))).collect()
    };
    let mut ready = Vec::new();
    let mut first = true;
    let mut write = |ready: Vec<serde_json::Result<Vec<u8>>>| -> std::io::Result<()> {
        for chunk in ready {
            if !std::mem::take(&mut first) {
                file.write_all(b",")?;
            }
            file.write_all(&chunk?)?;
        }
        Ok(())
    };
    for start in (0..tests.len()).step_by(ROUND) {
        let mut next = Vec::new();
        let written = rayon::in_place_scope(|scope| {
            scope.spawn(|_| next = round(start));
            write(std::mem::take(&mut ready))
        });
        written?;
        ready = next;
    }
    write(ready)?;
    if tests.is_empty() { Ok(()) } else { file.write_all(b"\n  ") }
}

/// Some elements of the list, a line each: without the comma before the first.
fn words(tests: &TestRecords, numbers: Range<usize>) -> serde_json::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    for (k, test) in tests.part(numbers).enumerate() {
        bytes.extend_from_slice(if k > 0 { b",\n    " } else { b"\n    " });
        json::line(&mut bytes, &test)?;
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with_tests(count: usize) -> FitRecord {
        let test = |j: usize| {
            serde_json::json!({ "id": format!("unit \"{j}\",\n  \"tests\": []"), "log_likelihood": j as f64 * 0.1, "observations": j,
                "phases": [{ "name": "main", "mean": [j as f64 / 3.0], "covariance": [[1e-300]] }],
                "distance": null, "degrees_of_freedom": 1, "p_value": 0.5 })
        };
        let tests: Vec<_> = (0..count).map(test).collect();
        serde_json::from_value(serde_json::json!({
            "schema": "kalfit-fit/1", "kalfit_version": "0", "title": "a title\n  \"tests\": []", "model_digest": null,
            "data": { "tests": count, "steps": 0, "observations": 0, "design_classes": 1 },
            "criterion": "ml", "log_likelihood_kind": "measurements", "log_likelihood": -1.5, "free_parameters": 1,
            "aic": null, "bic": null, "converged": true, "reason": "",
            "certificate": { "mean": 0.0, "covariance": 0.0, "null_space": 0.0, "parameters": 0.0 },
            "solver": { "method": "hybrid", "solver": "newton", "phases": "chain", "iterations": 0, "filter_passes": 0,
                "trace": [], "seconds": 0.5 },
            "phases": [], "parameters": [], "constraints": [], "tests": tests, "notes": ["\n  \"tests\": []"]
        }))
        .unwrap()
    }

    #[test]
    fn a_record_is_written_as_in_one_piece_by_any_number_of_threads() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fit.json");
        for count in [0, 1, 2, CHUNK, CHUNK + 1, 2 * ROUND + 7] {
            let mut record = with_tests(count);
            let expected = json::to_string(&record).unwrap() + "\n";
            for threads in [1, 2, 3] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                let output = OutputFile::prepare(&path, &[]).unwrap();
                pool.install(|| super::record(&output, &mut record)).unwrap();
                let written = std::fs::read_to_string(&path).unwrap();
                assert!(written == expected, "{count} tests, {threads} threads");
            }
            assert_eq!(record.tests.len(), count, "the record keeps its tests");
        }
    }
}

//! Bytes that nobody wrote, or that somebody wrote to hurt: an error or tests, never a panic.

#![expect(clippy::unwrap_used, reason = "also in what the tests share")]

use crate::support;

use std::sync::Arc;

use arrow_array::types::Int32Type;
use arrow_array::{ArrayRef, DictionaryArray, Float64Array, StringArray, StringViewArray};
use arrow_ipc::CompressionType;
use arrow_ipc::writer::IpcWriteOptions;
use proptest::prelude::*;
use support::*;

/// Reads bytes in every way a model may; the outcome does not matter, that there is one does.
fn survives(bytes: &[u8]) {
    let model = with_unit(model(&["t", "y"], &["lot", "y"], Some("t")), "s");
    let _ = collect_stdin(&model, &by("id"), bytes);
    let _ = collect_stdin(&support::model(&["y"], &["t"], None), &by("lot"), bytes);
}

fn sound(kind: usize) -> Vec<u8> {
    let dictionary: DictionaryArray<Int32Type> =
        ["A", "B", "A", "long enough to be no inline view"].into_iter().collect();
    let columns = batch(vec![
        ("id", Arc::new(StringArray::from(vec!["1", "1", "2", "2"])) as ArrayRef),
        ("t", Arc::new(Float64Array::from(vec![0.0, 1.0, 0.0, 1.0])) as ArrayRef),
        ("y", Arc::new(StringViewArray::from(vec![Some("1"), None, Some("2"), Some("3.00000000000000")])) as ArrayRef),
        ("lot", Arc::new(dictionary) as ArrayRef),
    ]);
    let packed = |codec| IpcWriteOptions::default().try_with_compression(Some(codec)).unwrap();
    match kind {
        0 => parquet(&columns, 2),
        1 => arrow_stream(&columns, 2),
        2 => arrow_file(&columns, 2, IpcWriteOptions::default()),
        3 => arrow_file(&columns, 4, packed(CompressionType::LZ4_FRAME)),
        4 => arrow_file(&columns, 4, packed(CompressionType::ZSTD)),
        _ => b"id,t,y,lot\n1,0,5,\"A\"\n1,1,,\"A\"\"\nB\"\n2,2024-01-01T00:00:00Z,6,C\n".to_vec(),
    }
}

#[test]
fn the_sound_files_are_read() {
    for kind in 0..5 {
        let model = model(&["t", "y"], &["lot"], Some("t"));
        let (sink, _) = collect_stdin(&model, &by("id"), &sound(kind)).unwrap_or_else(|e| panic!("kind {kind}: {e}"));
        assert_eq!(sink.tests.len(), 2, "kind {kind}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    #[test]
    fn random_bytes(start in prop::sample::select(vec![
        &b""[..], b"PAR1", b"ARROW1\0\0", b"\xff\xff\xff\xff", b"id,t,y,lot\n", b"\"id\";t;y;lot\r\n",
    ]), bytes in prop::collection::vec(any::<u8>(), 0..400), end in prop::sample::select(vec![
        &b""[..], b"PAR1", b"ARROW1", b"\xff\xff\xff\xff\0\0\0\0", b"\"",
    ])) {
        survives(&[start, &bytes, end].concat());
    }

    #[test]
    fn text_that_looks_like_csv(text in "[a-c0-9,;\t\"\r\n .eE+-]{0,200}") {
        survives(format!("id,t,y,lot\n{text}").as_bytes());
        survives(text.as_bytes());
    }

    #[test]
    fn sound_files_with_bytes_changed(
        kind in 0..6_usize,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
    ) {
        let mut bytes = sound(kind);
        for (index, value) in changes {
            let length = bytes.len();
            bytes[index.index(length)] = value;
        }
        survives(&bytes);
    }

    #[test]
    fn sound_files_cut_off(kind in 0..6_usize, length in any::<prop::sample::Index>()) {
        let bytes = sound(kind);
        survives(&bytes[..length.index(bytes.len())]);
    }

    #[test]
    fn sound_files_with_numbers_made_huge(
        kind in 0..5_usize,
        at in any::<prop::sample::Index>(),
        value in prop::sample::select(vec![i64::MAX, i64::MIN, -1, 1 << 40, i64::from(i32::MAX), 1 << 31]),
    ) {
        let mut bytes = sound(kind);
        let last = bytes.len() - 8;
        let at = at.index(last / 4 + 1) * 4;
        bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
        survives(&bytes);
    }
}

#[test]
fn a_packed_buffer_that_declares_a_petabyte_is_refused() {
    let mut bytes = sound(4);
    // The length before a zstd frame: eight bytes before its magic number.
    let magic = [0x28, 0xb5, 0x2f, 0xfd];
    let found: Vec<usize> = (8..bytes.len() - 4).filter(|&at| bytes[at..at + 4] == magic).collect();
    let bytes = if found.is_empty() {
        // Everything was too short to pack: unpacked buffers have -1 there.
        let raw = [0xff; 8];
        let body = bytes.windows(16).rposition(|w| w[..8] == raw && w[8..12] != raw[..4]).expect("a raw buffer");
        bytes[body..body + 8].copy_from_slice(&(1_i64 << 50).to_le_bytes());
        bytes
    } else {
        bytes[found[0] - 8..found[0]].copy_from_slice(&(1_i64 << 50).to_le_bytes());
        bytes
    };
    let error = collect_stdin(&model(&["t"], &[], None), &by("id"), &bytes).unwrap_err().to_string();
    assert!(error.contains("unpacked bytes declared"), "{error}");
}

#[test]
fn an_endless_row_is_refused_before_it_fills_the_memory() {
    use std::io::Read;
    let mut stdin = (&b"id,t\n1,\""[..]).chain(std::io::repeat(b'x'));
    let error = collect(&model(&["t"], &[], None), &by("id"), &[kalfit_data::Input::Stdin], &mut stdin).unwrap_err();
    assert_eq!(error.to_string(), "standard input, row 2: found a row of more than 67108864 bytes");
}

//! Bits of results, by the instructions that they were worked out with: a change of a digest here is a change of what users get, to be
//! named in the change log if it is meant. Rows are taken down anew from what the failing test prints.
//!
//! The last digits also depend on the mathematical library of the system and on whether products of matrices are fused: the rows are of
//! glibc on x86-64 with FMA. Elsewhere nothing is compared, and the test says so.

use kalfit::FitRecord;

use crate::sound::fit;

/// Small models, and options that make each fit at once.
const MODELS: [(&str, &str); 5] = [
    ("random-coefficients/sleepstudy", "--set sigma=25.59182"),
    ("meta-analysis/berkey1998", ""),
    ("gyro-bench/bench", ""),
    ("vaccine", ""),
    ("sensors", ""),
];

/// A digest that no machine at hand could take: nothing is compared.
const NOT_TAKEN: u64 = 0;

/// Digests of each model in the order of [`MODELS`].
const DIGESTS: [(&str, [u64; 5]); 3] = [
    (
        "portable",
        [
            0xd5e5_9f68_0fba_4d23,
            0xb535_8cd6_5aa9_58fa,
            0x50a4_1653_2275_48cb,
            0x42b0_1954_198d_452e,
            0x8862_1a4b_48fb_d9a0,
        ],
    ),
    (
        "avx2",
        [
            0xec39_104f_cd16_28d1,
            0xadaa_c1eb_49bd_3987,
            0x94ba_5346_7950_2def,
            0x2f4d_275f_f5e7_d36c,
            0x3659_7d54_eddc_0dc2,
        ],
    ),
    ("avx512", [0xec39_104f_cd16_28d1, 0x82c2_e84f_5b54_7bad, 0x62a4_9f4c_219e_095e, NOT_TAKEN, 0xd114_9b40_35bb_129b]),
];

/// FNV-1a of the bits of ℓ, θ and Σ.
fn digest(record: &FitRecord) -> u64 {
    let of_phases = record.phases.iter().flat_map(|phase| {
        let covariance = phase.covariance.estimate.iter().flatten().copied();
        phase.mean.estimate.iter().copied().chain(covariance)
    });
    let of_parameters = record.parameters.iter().map(|parameter| parameter.estimate);
    let numbers = std::iter::once(record.log_likelihood).chain(of_phases).chain(of_parameters);
    let bytes = numbers.flat_map(|number| number.to_bits().to_le_bytes());
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

/// Why the rows say nothing of this machine.
fn elsewhere() -> Option<&'static str> {
    if !cfg!(all(target_arch = "x86_64", target_os = "linux", target_env = "gnu")) {
        return Some("another system than x86-64 with glibc");
    }
    #[cfg(target_arch = "x86_64")]
    if !std::arch::is_x86_feature_detected!("fma") {
        return Some("a machine without FMA");
    }
    None
}

#[test]
fn results_have_the_bits_that_are_on_record() {
    if let Some(machine) = elsewhere() {
        return println!("{machine}: no digests are on record, nothing is compared");
    }
    let here: Vec<&str> = kalfit::Isa::all().iter().map(|isa| isa.word()).collect();
    let mut wrong = Vec::new();
    for (set, expected) in DIGESTS {
        if !here.contains(&set) {
            println!("this machine has no {set}: its digests are not compared");
            continue;
        }
        let found = MODELS.map(|(name, options)| digest(&fit(name, &format!("{options} --instructions {set}")).1));
        let is_other = |(found, expected): (&u64, &u64)| *expected != NOT_TAKEN && found != expected;
        if found.iter().zip(&expected).any(is_other) {
            wrong.push(format!("(\"{set}\", {found:#018x?}),\n  instead of {expected:#018x?}"));
        }
    }
    assert!(wrong.is_empty(), "results have other bits than before:\n{}", wrong.join("\n"));
}

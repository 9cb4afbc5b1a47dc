//! The book: what its pages show is what the command prints, its models are models, its links lead somewhere.
//!
//! `KALFIT_BOOK=write cargo test -p kalfit-cli --test book` (or `cargo dev book`) writes what the commands print into the pages,
//! and the reference anew. `KALFIT_BOOK_PAGE=tutorial` looks at the pages whose path contains this only.

#![expect(clippy::unwrap_used, reason = "a test that cannot be set up must fail")]

mod compare;
mod links;
mod page;
mod reference;
mod run;
mod source;
mod theory;

use std::path::PathBuf;

use page::Page;

/// The root of the project.
fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).unwrap().to_path_buf()
}

/// Whether pages are to be written rather than compared.
fn writing() -> bool {
    std::env::var("KALFIT_BOOK").is_ok_and(|word| word == "write")
}

/// Compares a generated text with the file in the book, or writes it.
fn fresh(path: &str, text: &str) {
    let file = root().join("book/src").join(path);
    if writing() {
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        std::fs::write(&file, text).unwrap();
        return;
    }
    let found = std::fs::read_to_string(&file).unwrap_or_default();
    assert!(found == text, "{path} is not what the code says; `cargo dev book` writes it anew");
}

#[test]
fn commands_print_what_the_pages_show() {
    let only = std::env::var("KALFIT_BOOK_PAGE").unwrap_or_default();
    let pages: Vec<Page> = Page::all().into_iter().filter(|page| page.path.contains(&only)).collect();
    let wrong: Vec<String> = pages.into_iter().flat_map(run::check).collect();
    assert!(wrong.is_empty(), "{}\n`cargo dev book` writes what the commands print into the pages", wrong.join("\n\n"));
}

#[test]
fn blocks_that_are_whole_models_are_accepted() {
    let mut models = 0;
    for page in Page::all() {
        for block in page.blocks().iter().filter(|block| block.is_model()) {
            models += 1;
            let place = format!("{}, line {}", page.path, block.at);
            if let Err(error) = kalfit_spec::Spec::parse(&place, &page.expanded(block)) {
                panic!("{place}: {error}");
            }
        }
    }
    assert!(models >= 8, "only {models} models in the book");
}

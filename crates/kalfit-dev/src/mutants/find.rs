//! Places of a source file that can be changed, and what each would be changed to.

use std::collections::BTreeMap;
use std::ops::Range;

use syn::spanned::Spanned;
use syn::visit::{self, Visit};
use syn::{Attribute, BinOp, Expr, ExprLit, Lit, Stmt, Type, UnOp};

/// What a stretch of a file becomes while its mutant is on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Replacement {
    /// This expression instead.
    Value(String),
    /// Nothing: the statement is left out.
    Nothing,
}

/// A change of a program: one stretch of a file, or every use of a constant in it.
#[derive(Debug, Clone)]
pub(super) struct SourceChange {
    pub(super) line: usize,
    /// Bytes of the file, apart from each other, and what they become.
    pub(super) edits: Vec<(Range<usize>, Replacement)>,
    /// In words: `a + b` → `a - b`.
    pub(super) what: String,
}

/// All changes of a file, tests apart.
pub(super) fn changes(source: &str) -> Result<Vec<SourceChange>, String> {
    let file = syn::parse_file(source).map_err(|error| error.to_string())?;
    let mut finder = ChangeFinder { source, found: Vec::new(), constants: BTreeMap::new(), uses: BTreeMap::new() };
    finder.visit_file(&file);
    finder.constants_in_use();
    Ok(finder.found)
}

struct ChangeFinder<'s> {
    source: &'s str,
    found: Vec<SourceChange>,
    /// Lines of constants, and what is multiplied or put in their place.
    constants: BTreeMap<String, (usize, String)>,
    /// Where they are used.
    uses: BTreeMap<String, Vec<Range<usize>>>,
}

/// Methods and what they are confused with.
const SWAPS: [(&str, &str); 12] = [
    ("max", "min"),
    ("min", "max"),
    ("minimum", "maximum"),
    ("maximum", "minimum"),
    ("fma", "fnma"),
    ("fnma", "fma"),
    ("any", "all"),
    ("all", "any"),
    ("first", "last"),
    ("last", "first"),
    ("is_some_and", "is_none_or"),
    ("is_none_or", "is_some_and"),
];

/// Methods that are left out: the number itself remains.
const DROPPED: [&str; 6] = ["abs", "sqrt", "magnitude", "recip", "exp_m1", "ln_1p"];

impl<'s> ChangeFinder<'s> {
    fn text(&self, node: &impl Spanned) -> &'s str {
        &self.source[node.span().byte_range()]
    }

    fn change(&mut self, node: &impl Spanned, other: String) {
        let what = format!("`{}` → `{}`", short(self.text(node)), short(&other));
        let edits = vec![(node.span().byte_range(), Replacement::Value(other))];
        self.found.push(SourceChange { line: node.span().start().line, edits, what });
    }

    /// One change for each constant: all its uses in the file.
    fn constants_in_use(&mut self) {
        for (name, (line, other)) in std::mem::take(&mut self.constants) {
            let Some(uses) = self.uses.remove(&name) else { continue };
            let edits = uses.into_iter().map(|range| (range, Replacement::Value(other.clone()))).collect();
            self.found.push(SourceChange { line, edits, what: format!("`{name}` → `{other}`") });
        }
    }

    fn binary(&mut self, node: &syn::ExprBinary) {
        let (left, right) = (self.text(&node.left), self.text(&node.right));
        let arithmetic = matches!(node.op, BinOp::Add(_) | BinOp::Sub(_) | BinOp::Mul(_) | BinOp::Div(_));
        if arithmetic && [&node.left, &node.right].into_iter().any(|side| counts(self.text(side), side)) {
            return;
        }
        let with_literal = is_number(&node.left) || is_number(&node.right);
        let others: &[&str] = match node.op {
            BinOp::Add(_) => &["-"],
            BinOp::Sub(_) => &["+"],
            BinOp::Mul(_) => &["/"],
            BinOp::Div(_) => &["*"],
            BinOp::And(_) => &["||"],
            BinOp::Or(_) => &["&&"],
            BinOp::Eq(_) => &["!="],
            BinOp::Ne(_) => &["=="],
            // numbers that are measured are seldom equal, but zero and one are
            BinOp::Lt(_) if with_literal => &[">=", "<="],
            BinOp::Le(_) if with_literal => &[">", "<"],
            BinOp::Gt(_) if with_literal => &["<=", ">="],
            BinOp::Ge(_) if with_literal => &["<", ">"],
            BinOp::Lt(_) => &[">="],
            BinOp::Le(_) => &[">"],
            BinOp::Gt(_) => &["<="],
            BinOp::Ge(_) => &["<"],
            BinOp::AddAssign(_) => &["-="],
            BinOp::SubAssign(_) => &["+="],
            BinOp::MulAssign(_) => &["/="],
            BinOp::DivAssign(_) => &["*="],
            BinOp::BitAndAssign(_) => &["|="],
            BinOp::BitOrAssign(_) => &["&="],
            _ => &[],
        };
        for other in others {
            self.change(node, format!("{left} {other} {right}"));
        }
    }

    fn condition(&mut self, condition: &Expr, others: &[&str]) {
        if !holds_let(condition) {
            others.iter().for_each(|other| self.change(condition, (*other).to_owned()));
        }
    }

    fn method(&mut self, node: &syn::ExprMethodCall) {
        let name = node.method.to_string();
        let receiver = self.text(&node.receiver);
        if let Some((_, other)) = SWAPS.iter().find(|(from, _)| *from == name) {
            let (whole, method) = (node.span().byte_range(), node.method.span().byte_range());
            let (before, after) = (&self.source[whole.start..method.start], &self.source[method.end..whole.end]);
            self.change(node, format!("{before}{other}{after}"));
        }
        if DROPPED.contains(&name.as_str()) {
            self.change(node, receiver.to_owned());
        }
        if name == "transpose" {
            self.change(node, format!("({receiver}).clone_owned()"));
        }
    }

    fn literal(&mut self, node: &ExprLit) {
        match &node.lit {
            Lit::Float(number) => {
                if let Ok(value) = number.base10_parse::<f64>() {
                    self.change(node, format!("{:?}{}", another(value), number.suffix()));
                }
            }
            Lit::Int(number) => {
                if let Ok(value) = number.base10_parse::<u64>() {
                    self.change(node, format!("{}{}", value + 1, number.suffix()));
                }
            }
            Lit::Bool(truth) => self.change(node, (!truth.value).to_string()),
            _ => {}
        }
    }

    fn statement(&mut self, node: &Expr, whole: &Stmt) {
        let acts = match node {
            Expr::MethodCall(call) => call.method != "reserve",
            Expr::Assign(_) | Expr::Call(_) | Expr::Break(_) | Expr::Continue(_) | Expr::Return(_) => true,
            _ => false,
        };
        if acts {
            let what = format!("`{}` left out", short(self.text(whole)));
            let edits = vec![(whole.span().byte_range(), Replacement::Nothing)];
            self.found.push(SourceChange { line: whole.span().start().line, edits, what });
        }
    }
}

impl<'ast> Visit<'ast> for ChangeFinder<'_> {
    fn visit_item(&mut self, node: &'ast syn::Item) {
        let attributes = match node {
            syn::Item::Mod(item) => &item.attrs,
            syn::Item::Fn(item) => &item.attrs,
            syn::Item::Impl(item) => &item.attrs,
            syn::Item::Const(item) => {
                let text = self.source[item.expr.span().byte_range()].to_owned();
                if let Some(other) = other_constant(&item.ident.to_string(), &item.ty, &text) {
                    self.constants.insert(item.ident.to_string(), (item.span().start().line, other));
                }
                return;
            }
            syn::Item::Static(_) => return,
            _ => return visit::visit_item(self, node),
        };
        if !is_for_tests(attributes) {
            visit::visit_item(self, node);
        }
    }

    fn visit_impl_item(&mut self, node: &'ast syn::ImplItem) {
        match node {
            syn::ImplItem::Fn(item) if !is_for_tests(&item.attrs) => visit::visit_impl_item(self, node),
            _ => {}
        }
    }

    fn visit_attribute(&mut self, _: &'ast Attribute) {}

    fn visit_type(&mut self, _: &'ast Type) {}

    fn visit_generic_argument(&mut self, _: &'ast syn::GenericArgument) {}

    /// Patterns stay as they are, but for what guards them.
    fn visit_pat(&mut self, node: &'ast syn::Pat) {
        if let syn::Pat::Guard(guard) = node {
            self.visit_expr(&guard.guard);
        }
    }

    fn visit_stmt(&mut self, node: &'ast Stmt) {
        if let Stmt::Expr(expression, Some(_)) = node {
            self.statement(expression, node);
        }
        visit::visit_stmt(self, node);
    }

    fn visit_expr(&mut self, node: &'ast Expr) {
        match node {
            // a wrong index panics, which any test finds
            Expr::Index(index) => return self.visit_expr(&index.expr),
            Expr::Repeat(repeat) => return self.visit_expr(&repeat.expr),
            // the same program in other memory
            Expr::Call(call) if self.text(&call.func).ends_with("with_capacity") => return,
            Expr::MethodCall(call) if call.method == "reserve" => return,
            Expr::Binary(binary) => self.binary(binary),
            Expr::If(branch) => self.condition(&branch.cond, &["true", "false"]),
            Expr::While(lasts) => self.condition(&lasts.cond, &["false"]),
            Expr::MethodCall(call) => self.method(call),
            Expr::Lit(literal) => self.literal(literal),
            Expr::Unary(unary) if matches!(unary.op, UnOp::Not(_) | UnOp::Neg(_)) => {
                let inner = self.text(&unary.expr).to_owned();
                self.change(node, inner);
            }
            Expr::Path(path) => {
                if let Some(name) = path.path.get_ident() {
                    self.uses.entry(name.to_string()).or_default().push(node.span().byte_range());
                }
            }
            _ => {}
        }
        visit::visit_expr(self, node);
    }
}

/// Tolerances become a thousand times as large, for twice a tolerance is as good; other numbers twice as large, and zero one.
fn another(value: f64) -> f64 {
    if value == 0.0 {
        1.0
    } else if value.abs() < 1e-2 {
        1e3 * value
    } else {
        2.0 * value
    }
}

/// What stands for a constant: as for numbers; a count becomes one.
fn other_constant(name: &str, kind: &Type, text: &str) -> Option<String> {
    let Type::Path(path) = kind else { return None };
    match path.path.get_ident()?.to_string().as_str() {
        "f64" => {
            let small = text.parse::<f64>().is_ok_and(|value| value.abs() < 1e-2);
            Some(format!("({name} * {:?})", if small { 1e3 } else { 2.0 }))
        }
        "usize" | "u32" | "u64" | "i32" => Some(if text == "1" { "2" } else { "1" }.to_owned()),
        _ => None,
    }
}

/// Whether a side of an operation says that it counts or indexes: wrong counts panic, which any test finds.
fn counts(text: &str, side: &Expr) -> bool {
    let is_integer = matches!(side, Expr::Lit(ExprLit { lit: Lit::Int(_), .. }));
    is_integer || [".len()", ".nrows()", ".ncols()", ".count()"].iter().any(|end| text.ends_with(end))
}

fn is_number(side: &Expr) -> bool {
    match side {
        Expr::Lit(literal) => matches!(literal.lit, Lit::Float(_) | Lit::Int(_)),
        Expr::Unary(unary) => is_number(&unary.expr),
        _ => false,
    }
}

fn holds_let(condition: &Expr) -> bool {
    match condition {
        Expr::Let(_) => true,
        Expr::Binary(binary) => holds_let(&binary.left) || holds_let(&binary.right),
        _ => false,
    }
}

fn is_for_tests(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| match &attribute.meta {
        syn::Meta::List(list) => list.path.is_ident("cfg") && list.tokens.to_string().contains("test"),
        meta => meta.path().is_ident("test"),
    })
}

/// On one line, and not too long.
pub(super) fn short(text: &str) -> String {
    let line = text.split_whitespace().collect::<Vec<_>>().join(" ");
    if line.chars().count() <= 70 { line } else { line.chars().take(67).chain("...".chars()).collect() }
}

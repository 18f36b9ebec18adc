//! `#[gpu_test]`, which is `#[test]` for tests that need a GPU.
//!
//! ```text
//! #[gpu_test]                       #[test]
//! #[ignore = "slow: 4 GB"]          #[ignore = "slow: 4 GB"]
//! fn large_grids_are_drawn() {  →   fn large_grids_are_drawn() {
//!     …                                 if !crate::has_gpu() { return; }
//! }                                     …
//!                                   }
//! ```
//!
//! A test program has `fn has_gpu() -> bool` at its root, usually through an import; that function reports that a
//! test is skipped, or panics. All other attributes stay, and panics and compiler errors point to the lines of
//! the test.

use proc_macro::{Delimiter, Group, TokenStream, TokenTree};

/// Turns a function without arguments and return value into a test. Without a GPU, the test returns at once.
#[proc_macro_attribute]
pub fn gpu_test(arguments: TokenStream, function: TokenStream) -> TokenStream {
    // Attributes, the signature, and last the body.
    let mut tokens: Vec<TokenTree> = function.into_iter().collect();
    let body = match tokens.pop() {
        Some(TokenTree::Group(body)) if body.delimiter() == Delimiter::Brace => body,
        _ => return made("compile_error! { \"`#[gpu_test]` stands before a function\" }"),
    };
    if !arguments.is_empty() {
        return made("compile_error! { \"`#[gpu_test]` has no arguments\" }");
    }
    let mut guarded = made("if !crate::has_gpu() { return; }");
    guarded.extend(body.stream());
    let mut whole = Group::new(Delimiter::Brace, guarded);
    whole.set_span(body.span());
    tokens.push(TokenTree::Group(whole));
    made("#[test]").into_iter().chain(tokens).collect()
}

/// Code of our own, with the span of the attribute.
fn made(code: &str) -> TokenStream {
    code.parse().expect("it is Rust")
}

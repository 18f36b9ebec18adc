//! The size of shaders after inlining, which determines how long drivers take to compile them.

use std::collections::HashMap;

use naga::{Block, Function, Handle, Module, Statement};

use crate::compose::{SMOKE_AND_FIRE, composed, composer};

/// The blocks within a statement.
fn blocks(statement: &Statement) -> Vec<&Block> {
    match statement {
        Statement::Block(block) => vec![block],
        Statement::If { accept, reject, .. } => vec![accept, reject],
        Statement::Switch { cases, .. } => cases.iter().map(|case| &case.body).collect(),
        Statement::Loop { body, continuing, .. } => vec![body, continuing],
        _ => Vec::new(),
    }
}

/// The number of statements of a block, and the functions that it calls, once for each call.
fn statements(block: &Block) -> (usize, Vec<Handle<Function>>) {
    let (mut count, mut calls) = (block.len(), Vec::new());
    for statement in block {
        if let Statement::Call { function, .. } = statement {
            calls.push(*function);
        }
        for inner in blocks(statement) {
            let (more, further) = statements(inner);
            count += more;
            calls.extend(further);
        }
    }
    (count, calls)
}

/// The statements and expressions of each function with all that it calls, and those of the entry point.
fn inlined(module: &Module) -> (HashMap<Handle<Function>, usize>, usize) {
    let mut sizes = HashMap::new();
    // Naga lists functions after those that they call.
    let size_of = |function: &Function, sizes: &HashMap<Handle<Function>, usize>| {
        let (count, calls) = statements(&function.body);
        count + function.expressions.len() + calls.iter().map(|call| sizes[call]).sum::<usize>()
    };
    for (handle, function) in module.functions.iter() {
        let size = size_of(function, &sizes);
        sizes.insert(handle, size);
    }
    let entries = module.entry_points.iter().map(|entry| size_of(&entry.function, &sizes));
    let largest = entries.max().expect("an entry point");
    (sizes, largest)
}

/// NVIDIA's driver takes half a minute for this variant. `docs/internals/notebook.md`, "What drivers compile", has the
/// times, and the sizes that go with them.
#[test]
fn drivers_compile_a_bounded_amount_of_code() {
    let defs: Vec<&str> = SMOKE_AND_FIRE.split_whitespace().collect();
    let module = composed(&mut composer(), "trace/trace", &defs);
    let (sizes, all) = inlined(&module);
    let mut largest: Vec<_> = sizes.into_iter().collect();
    largest.sort_by_key(|(_, size)| std::cmp::Reverse(*size));
    for (function, size) in largest.iter().take(20) {
        println!("{size:>8} {}", module.functions[*function].name.as_deref().unwrap_or("?"));
    }
    println!("{all:>8} in all");
    assert!(all < 160_000, "{all} statements and expressions");
}

//! The option shared by all commands that read files.

use vdb_core::Limits;

#[derive(clap::Args)]
pub struct LimitArgs {
    /// Read files that demand more memory than a desktop with 8 GB can spare
    #[arg(long)]
    no_limits: bool,
}

impl LimitArgs {
    pub fn limits(&self) -> Limits {
        if self.no_limits { Limits::UNLIMITED } else { Limits::default() }
    }
}

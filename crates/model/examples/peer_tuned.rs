//! `peer` with the allocator of our programs, which keeps large buffers.

#[path = "peer/main.rs"]
mod peer;

#[global_allocator]
static ALLOCATOR: where2act_kernels::KeepLarge = where2act_kernels::KeepLarge::new();

fn main() -> anyhow::Result<()> {
    peer::main()
}

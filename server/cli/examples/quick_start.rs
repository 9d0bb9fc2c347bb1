//! The Rust quick start of docs/rust.md, word for word; a test compares and runs it.
#![allow(clippy::print_stdout)]

use trocar_client::{Client, SessionRequest};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let client = Client::connect_private()?; // or Client::connect("lab")?
    let mut session = client.open(&SessionRequest::new("NeedleReach-v0").envs(64).seed(0))?;
    session.want_expert(true); // replies also say what the scripted expert would do
    let mut actions = session.reset()?.expert_action().to_vec(); // 64 rows of 5 numbers
    loop {
        let reply = session.step(&actions)?; // arrays in shared memory, row by row
        if reply.truncated()[0] == 1 {
            let successes: u32 = reply.is_success().iter().map(|flag| u32::from(*flag)).sum();
            println!("{successes} of {} episodes ended in success", reply.rows());
            return Ok(());
        }
        actions.copy_from_slice(reply.expert_action());
    }
}

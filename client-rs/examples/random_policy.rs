//! Opens 16 environments, lets the scripted expert act in half of them and random actions in the
//! other half, and prints how many ended in success.
//!
//! ```sh
//! trocar serve --name lab &
//! cargo run --release --example random_policy -- lab
//! ```

use trocar_client::{Client, SessionRequest};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let client = match std::env::args().nth(1) {
        Some(name) => Client::connect(&name)?,
        None => Client::connect_private()?,
    };
    let mut session = client.open(&SessionRequest::new("NeedleReach-v0").envs(16))?;
    session.want_expert(true);
    let dim = session.spec().action_dim();
    let mut actions = session.reset()?.expert_action().to_vec();
    let mut random = 1_u32;
    loop {
        for value in &mut actions[8 * dim..] {
            // xorshift32: enough for an example, and the same everywhere.
            random ^= random << 13;
            random ^= random >> 17;
            random ^= random << 5;
            *value = random as f32 / u32::MAX as f32 * 2.0 - 1.0;
        }
        let reply = session.step(&actions)?;
        if reply.truncated()[0] == 1 {
            let successes = |rows: std::ops::Range<usize>| -> u32 {
                reply.is_success()[rows].iter().map(|&flag| u32::from(flag)).sum()
            };
            eprintln!("expert: {} of 8, random: {} of 8", successes(0..8), successes(8..16));
            return Ok(());
        }
        actions.copy_from_slice(reply.expert_action());
    }
}

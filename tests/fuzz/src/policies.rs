//! Policies: ONNX files, what they say of themselves, and their first action.

use std::path::Path;
use std::sync::LazyLock;

use trocar_network::{Error, Network, Seen};
use trocar_proto::{Options, TaskSpec};
use trocar_server::Registry;

static TASK: LazyLock<TaskSpec> =
    LazyLock::new(|| Registry::builtin().spec("EcmReach-v0", &Options::new()).expect("a task"));

/// A file.
pub(crate) fn run(data: &[u8]) {
    let network = match Network::read(Path::new("policy.onnx"), data.to_vec()) {
        Ok(network) => network,
        Err(error) => return assert!(!error.to_string().is_empty()),
    };
    if network.check(&TASK).is_ok() {
        act(&network).ok();
    }
}

/// The action that it chooses, whole or not at all.
fn act(network: &Network) -> Result<(), Error> {
    let [observation, achieved, desired] =
        [TASK.observation_dim(), TASK.goal_dim(), TASK.goal_dim()].map(|dim| vec![0.5; dim]);
    let seen = Seen { observation: &observation, achieved: &achieved, desired: &desired };
    let mut action = vec![7.0; TASK.action_dim()];
    let acted = network.act(&seen, &mut action);
    let untouched = action.iter().all(|number| *number == 7.0);
    assert!(acted.is_ok() || untouched, "{acted:?}: an action is whole or none");
    acted
}

/// A protobuf message that is being written.
#[derive(Default)]
struct Proto(Vec<u8>);

impl Proto {
    fn varint(&mut self, mut number: u64) {
        while number > 0x7f {
            self.0.push(number as u8 | 0x80);
            number >>= 7;
        }
        self.0.push(number as u8);
    }

    fn number(mut self, field: u64, number: u64) -> Self {
        self.varint(field << 3);
        self.varint(number);
        self
    }

    fn bytes(mut self, field: u64, bytes: &[u8]) -> Self {
        self.varint(field << 3 | 2);
        self.varint(bytes.len() as u64);
        self.0.extend(bytes);
        self
    }

    fn text(self, field: u64, text: &str) -> Self {
        self.bytes(field, text.as_bytes())
    }

    fn message(self, field: u64, message: &Self) -> Self {
        self.bytes(field, &message.0)
    }
}

fn value(name: &str, width: usize) -> Proto {
    let dim = |size: usize| Proto::default().number(1, size as u64);
    let shape = Proto::default().message(1, &dim(1)).message(1, &dim(width));
    let tensor = Proto::default().number(1, 1).message(2, &shape);
    Proto::default().text(1, name).message(2, &Proto::default().message(1, &tensor))
}

fn weights(name: &str, dims: &[usize]) -> Proto {
    let numbers = vec![0.25_f32; dims.iter().product()];
    let raw: Vec<u8> = numbers.into_iter().flat_map(f32::to_le_bytes).collect();
    let shaped = dims.iter().fold(Proto::default(), |proto, dim| proto.number(1, *dim as u64));
    shaped.number(2, 1).text(8, name).bytes(9, &raw)
}

fn node(op: &str, inputs: &[&str], output: &str) -> Proto {
    let with_inputs = inputs.iter().fold(Proto::default(), |proto, name| proto.text(1, name));
    with_inputs.text(2, output).text(3, output).text(4, op)
}

/// A file with these nodes and weights, from what is seen to an action.
fn model(nodes: &[Proto], tensors: &[Proto], inputs: &[(&str, usize)]) -> Vec<u8> {
    let graph = nodes.iter().fold(Proto::default(), |graph, node| graph.message(1, node));
    let graph =
        tensors.iter().fold(graph.text(2, "policy"), |graph, tensor| graph.message(5, tensor));
    let graph =
        inputs.iter().fold(graph, |graph, (name, width)| graph.message(11, &value(name, *width)));
    let graph = graph.message(12, &value("action", TASK.action_dim()));
    let task = Proto::default().text(1, "trocar.task").text(2, &TASK.id);
    let opset = Proto::default().number(2, 17);
    let file = Proto::default().number(1, 8).message(7, &graph).message(8, &opset);
    file.message(14, &task).0
}

pub(crate) fn seeds() -> Vec<Vec<u8>> {
    let (seen, goal, action) = (TASK.observation_dim(), TASK.goal_dim(), TASK.action_dim());
    let axis = Proto::default().text(1, "axis").number(3, 1).number(20, 2);
    let joined = node("Concat", &["observation", "desired_goal"], "joined").message(5, &axis);
    let layers = [
        joined,
        node("Gemm", &["joined", "w", "b"], "hidden"),
        node("Relu", &["hidden"], "positive"),
        node("Clip", &["positive", "least", "most"], "clipped"),
        node("Tanh", &["clipped"], "action"),
    ];
    let tensors = [
        weights("w", &[seen + goal, action]),
        weights("b", &[action]),
        weights("least", &[]),
        weights("most", &[]),
    ];
    let small = [
        node("Mul", &["achieved_goal", "s"], "scaled"),
        node("Sub", &["desired_goal", "scaled"], "left"),
        node("MatMul", &["left", "m"], "action"),
    ];
    let few = [weights("s", &[1]), weights("m", &[goal, action])];
    vec![
        model(&layers, &tensors, &[("observation", seen), ("desired_goal", goal)]),
        model(&small, &few, &[("achieved_goal", goal), ("desired_goal", goal)]),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_are_policies_that_act() {
        for seed in seeds() {
            let network = Network::read(Path::new("policy.onnx"), seed).unwrap();
            network.check(&TASK).unwrap();
            act(&network).unwrap();
        }
    }
}

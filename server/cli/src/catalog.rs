//! Sources of tasks: this program, and servers, which may have tasks of their own.

use trocar_client::Client;
use trocar_proto::{Options, TaskSpec};
use trocar_server::Registry;

/// The tasks of a command, and the place of its environments.
pub(crate) enum Catalog {
    /// This program's tasks, in this process.
    Builtin(Registry),
    /// A server's tasks, in that server.
    Server(Client),
}

impl Catalog {
    /// The tasks of the server `--server`; without that flag, this program's.
    pub(crate) fn open(server: Option<&str>) -> anyhow::Result<Self> {
        Ok(match server {
            Some(name) => Self::Server(Client::connect(name)?),
            None => Self::Builtin(Registry::builtin()),
        })
    }

    /// Ids of all tasks.
    pub(crate) fn tasks(&self) -> anyhow::Result<Vec<String>> {
        Ok(match self {
            Self::Builtin(registry) => registry.ids().map(str::to_string).collect(),
            Self::Server(client) => client.tasks()?,
        })
    }

    /// The task `id` under `options`.
    pub(crate) fn spec(&self, id: &str, options: &Options) -> anyhow::Result<TaskSpec> {
        Ok(match self {
            Self::Builtin(registry) => registry.spec(id, options)?,
            Self::Server(client) => client.describe(id, options)?,
        })
    }

    /// Tasks by id, under their defaults.
    pub(crate) fn specs(&self, ids: &[String]) -> anyhow::Result<Vec<TaskSpec>> {
        ids.iter().map(|id| self.spec(id, &Options::new())).collect()
    }
}

//! Where a server is found: its name, its folder, and how the transport is configured.
//!
//! Both sides build the transport's whole configuration here, in code, so that no file found in
//! a working directory can change it. Everything lives in `/dev/shm`, so that processes which
//! share only that (containers, say) meet, and one look there shows whether anything is left.

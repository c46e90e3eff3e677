//! Plays a controller with moto-hses-mock, a server of others: one alarm, at the ports that the maker's have.

use moto_hses_mock::{MockConfig, MockServer};
use moto_hses_proto::payload::alarm::test_alarms::servo_error;
use moto_hses_proto::{FILE_CONTROL_PORT, ROBOT_CONTROL_PORT};

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
    let address = std::env::args().nth(1).ok_or("give the ADDRESS")?;
    let server = MockServer::new(MockConfig::new(address, ROBOT_CONTROL_PORT, FILE_CONTROL_PORT)).await?;
    server.add_test_alarm(servo_error()).await;
    println!("ready");
    server.run().await
}

//! Reads a controller with moto-hses-client, a client of others, and prints what it understood as one JSON object.

use moto_hses_client::HsesClient;
use moto_hses_proto::{AlarmAttribute, Position, FILE_CONTROL_PORT, ROBOT_CONTROL_PORT};

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let address = std::env::args().nth(1).ok_or("give the ADDRESS")?;
    let client = HsesClient::new(&format!("{address}:{ROBOT_CONTROL_PORT}")).await?;
    let status = client.read_status().await?;
    let alarm = client.read_alarm_data(1, AlarmAttribute::All).await?;
    let file_port = HsesClient::new(&format!("{address}:{FILE_CONTROL_PORT}")).await?;
    let files = file_port.read_file_list("*.CND").await?;
    let homes = file_port.receive_file("ABSO.DAT").await?;
    let Position::Pulse(pulse) = client.read_position(1).await? else {
        return Err("a pose came where pulses belong".into());
    };
    let (servo, alarmed, pulses) = (status.is_servo_on(), status.has_alarm(), pulse.joints);
    println!("{{\"servo\": {servo}, \"has_alarm\": {alarmed}, \"pulses\": {pulses:?}, \"code\": {},", alarm.code);
    println!("\"name\": {:?}, \"files\": {files:?}, \"homes\": {homes:?}}}", alarm.name);
    Ok(())
}
